"""Small grasp files and bad input for the tests of retarget and evaluate."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from fungrasp.cli.main import main
from fungrasp.grasps import HumanGraspSet, builtin_grasps, save_human_grasps


def some_grasps(names: tuple[str, ...] = ("can", "tennis_ball")) -> HumanGraspSet:
    """The first built-in grasp of each object."""
    grasps = builtin_grasps()
    return grasps.select([np.flatnonzero(grasps.object_name == name)[0] for name in names])


def run(capsys: Any, *arguments: object) -> tuple[int, str, str]:
    status = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def check_bad_inputs(folder: Path, capsys: Any, command: str, *written: object) -> None:
    """Check that retarget or evaluate refuses bad input in one line. written: what it would write."""
    for name, (arguments, words) in _bad_inputs(folder).items():
        status, out, err = run(capsys, command, *arguments, *written)
        assert status == 2 and out == "", name
        assert err.startswith("fungrasp: error: ") and err.count("\n") == 1 and words in err, (name, err)


def _bad_inputs(folder: Path) -> dict[str, tuple[list[object], str]]:
    """By name: arguments that retarget and evaluate share, and words of the error."""
    good = some_grasps()
    save_human_grasps(folder / "good.npz", good)
    (folder / "short.npz").write_bytes((folder / "good.npz").read_bytes()[:300])
    with np.load(folder / "good.npz") as data:
        arrays = dict(data)
    np.savez(folder / "shape.npz", **arrays | {"hand_joints": good.hand_joints[:, :20]})  # pyright: ignore[reportArgumentType]
    for name in ("hand_joints", "object_pose"):
        missing = np.where(
            np.arange(arrays[name][0].size).reshape(arrays[name][0].shape) == 2, np.nan, arrays[name]
        )
        np.savez(folder / f"nan_{name}.npz", **arrays | {name: missing})  # pyright: ignore[reportArgumentType]
    meshes, millimeters, huge = folder / "meshes", folder / "millimeters", folder / "huge"
    for place, size in ((meshes, 0.06), (millimeters, 60.0), (huge, 1.8)):
        place.mkdir()
        trimesh.creation.box((size, size, size)).export(place / "block.obj")
    (meshes / "broken.obj").write_text("v 0 0 nonsense\n")
    for name in ("block", "broken", "cann"):
        named = dataclasses.replace(good, object_name=np.full(len(good), name))
        save_human_grasps(folder / f"{name}.npz", named)
    thumbless = folder / "thumbless"
    thumbless.mkdir()
    (thumbless / "hand.xml").write_text(
        '<mujoco><worldbody><body name="palm"><geom size=".01"/><body name="f"><joint name="j" range="0 1"/>'
        '<geom size=".01"/><site name="tip"/></body></body></worldbody></mujoco>'
    )
    (thumbless / "hand.toml").write_text(
        'name = "claw"\nmodel = "hand.xml"\npalm = "palm"\n[fingers.index]\nlinks = ["f"]\ntip = "tip"\n'
        "[actuators]\nkp = 1\nkd = 0.1\nforce_limit = 1\n"
    )
    return {
        "no file": (["--grasps", folder / "none.npz"], "none.npz does not exist"),
        "cut short": (["--grasps", folder / "short.npz"], "short.npz"),
        "shape": (["--grasps", folder / "shape.npz"], "has shape (2, 20, 3), expected (N, 21, 3)"),
        "nan joints": (["--grasps", folder / "nan_hand_joints.npz"], "'hand_joints', row 0 is not finite"),
        "nan pose": (["--grasps", folder / "nan_object_pose.npz"], "'object_pose', row 0 is not finite"),
        "unknown object": (["--grasps", folder / "cann.npz"], "Did you mean 'can'?"),
        "no folder": (["--grasps", folder / "block.npz", "--objects", folder / "no"], "does not exist"),
        "broken mesh": (["--grasps", folder / "broken.npz", "--objects", meshes], "broken.obj"),
        "millimeters": (["--grasps", folder / "block.npz", "--objects", millimeters], "meters"),
        "too large": (["--grasps", folder / "block.npz", "--objects", huge], "block"),
        "unknown hand": (["--grasps", folder / "good.npz", "--hand", "allegra"], "Did you mean 'allegro'?"),
        "no thumb": (["--grasps", folder / "good.npz", "--hand", thumbless], "no thumb"),
        "unknown method": (
            ["--grasps", folder / "good.npz", "--method", "contakt"],
            "Did you mean 'contact'?",
        ),
    }
