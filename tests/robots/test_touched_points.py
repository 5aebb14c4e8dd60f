"""Whether base and mount are where a cell says, by points that the robot has touched."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_cells import cell_and_hand

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.hands.arm import Mount, mounting_pose
from fungrasp.robots.arms.ur import arm_flange
from fungrasp.robots.calibration.touched import TouchedPoint, add_touched, check_touched, touched_place
from fungrasp.robots.kinematics.arm_model import ArmKinematics

JOINTS = np.array([[turn, -1.5, 2.0, -2.0, -1.57, 0.0] for turn in (-0.6, 0.0, 0.7)])


def touched(file: Path, turn: float = 0.0, shift: float = 0.0) -> str:
    """What a person writes down where the base is turned about z, at its foot, and shifted along x."""
    cell, _ = cell_and_hand()
    base = np.array(cell.arm.pose_world_base[:3])
    points = flange_places(cell) - base
    c, s = np.cos(turn), np.sin(turn)
    points = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + base + [shift, 0, 0]
    return write(file, JOINTS, points)


def flange_places(cell: Any) -> np.ndarray:
    """Middle of the flange in each of ``JOINTS``, world frame [m], shape [3, 3]."""
    places = np.array([arm_flange(cell.arm.model)(q) for q in JOINTS])
    return transform_points(np.array(cell.arm.pose_world_base), places)


def write(file: Path, joints: np.ndarray, points: np.ndarray, hand_point: list[float] | None = None) -> str:
    """A file of touched points; its name."""
    rows = [{"joints": q, "point": p} for q, p in zip(joints.tolist(), points.tolist(), strict=True)]
    by_hand = {} if hand_point is None else {"hand_point": hand_point}
    file.write_text(json.dumps({"touched": [{**row, **by_hand} for row in rows]}))
    return str(file)


def test_a_base_that_is_turned_or_shifted_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check = ["robots", "check", "ur5e-allegro", "--touched"]
    assert main([*check, touched(tmp_path / "a.json", shift=0.002)]) == 0
    assert "3 touched points, within 2.0 mm" in capsys.readouterr().out
    # Heights are the same: points on the table alone do not show it.
    assert main([*check, touched(tmp_path / "b.json", turn=np.pi)]) != 0
    said = capsys.readouterr().err
    assert "180 degrees about z" in said and "the pendant's Base is turned by 180 degrees from ours" in said
    assert main([*check, touched(tmp_path / "c.json", shift=0.02)]) != 0
    assert "turned by 0 degrees about z, and off by (20, 0, 0) mm" in capsys.readouterr().err


def test_too_few_or_too_near_points_are_refused(tmp_path: Path) -> None:
    (cell, hand), path = cell_and_hand(), tmp_path / "touched.json"
    for count, said in ((2, "3 touched points or more"), (3, "too near")):
        write(path, JOINTS[[0] * count], flange_places(cell)[[0] * count])
        with pytest.raises(FungraspError, match=said):
            check_touched(path, cell, hand)


def touched_by_hand(file: Path, cell: Any, hand: Any, point: list[float], error: np.ndarray) -> None:
    """Add to a file what a hand touched that is mounted off by an error, frame of the flange [m]."""
    kinematics = ArmKinematics(cell, hand)
    joints = np.array([[0.0, -1.9, 1.9, -1.57, -1.57, 0.0], [0.3, -1.7, 1.6, -1.2, -1.0, 0.8]])
    flange = compose(
        np.array([kinematics.palm_pose(q) for q in joints]), invert(mounting_pose(hand, cell.mount))
    )
    given = np.array(cell.mount.pose_flange_hand)
    there = transform_points(given, np.array([point]))[0] + error
    touched = np.array([transform_points(one, there[None])[0] for one in flange])
    known = json.loads(file.read_text())["touched"]
    write(file, joints, touched, point)
    file.write_text(json.dumps({"touched": known + json.loads(file.read_text())["touched"]}))


def test_a_hand_mounted_otherwise_is_seen_by_what_it_touches(tmp_path: Path) -> None:
    (cell, hand), path = cell_and_hand(), tmp_path / "touched.json"
    turned = Mount(pose_flange_hand=(0.0, 0.0, 0.04, 0.7071068, 0.0, 0.0, 0.7071068))
    cell = replace(cell, mount=turned)
    assert list(check_touched(touched(path), cell, hand)) == ["base"]
    for error, said in (([0.0, 0.0, 0.0], ""), ([0.0, 0.0, 0.116], r"116 mm.*\(0, 0, 116\) mm")):
        touched(path)
        touched_by_hand(path, cell, hand, [0.02, 0.0, 0.15], np.array(error))
        found = check_touched(path, cell, hand)["mount"]
        assert found.count == 2
        assert bool(found.fault) is bool(said) and re.search(said, found.fault)
    # Not turned as the cell says: a point beside the axis is elsewhere.
    straight = replace(cell, mount=Mount(pose_flange_hand=(0.0, 0.0, 0.04, 1.0, 0.0, 0.0, 0.0)))
    assert "pose_flange_hand" in check_touched(path, straight, hand)["mount"].fault
    write(path, JOINTS[:, :5], flange_places(cell))
    with pytest.raises(FungraspError, match="'joints' needs a posture of 6 joints for each point"):
        check_touched(path, cell, hand)


def test_points_are_written_down_as_the_arm_touches_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (cell, hand), path = cell_and_hand(), tmp_path / "touched.json"
    postures = iter(JOINTS)
    monkeypatch.setattr("fungrasp.robots.single_devices.arm_at_rest", lambda *cell: next(postures))
    for place in flange_places(cell):
        x, y, z = np.add(place, (0.0, 0.003, 0.0))
        command = ["robots", "touch", "ur5e-allegro-emulated", str(path), "--at", f"{x}", f"{y}", f"{z}"]
        assert main(command) == 0, capsys.readouterr().err
        assert "(0, 3, 0) mm from where the cell file puts it" in capsys.readouterr().out
    assert check_touched(path, cell, hand)["base"].miss == pytest.approx(0.003)
    # The hand's own points go into the same file.
    for number, joints in enumerate(JOINTS[:2], 1):
        by_hand = TouchedPoint(tuple(joints.tolist()), (0.0, 0.0, 0.0), (0.02, 0.0, 0.15 * number))
        x, y, z = touched_place(by_hand, cell, hand).tolist()
        assert add_touched(path, replace(by_hand, point=(x, y, z))) == number
    found = check_touched(path, cell, hand)["mount"]
    assert found.count == 2 and found.miss < 1e-6
