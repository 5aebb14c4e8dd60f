"""Warnings on the command line: one line for each kind, and stdout has the answer alone."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from fungrasp.cli.main import main, run_command
from fungrasp.grasps import HumanGraspSet, builtin_grasps, save_human_grasps


@dataclass(frozen=True)
class Warn:
    """A command that warns of the same things again and again."""

    def run(self) -> None:
        log = logging.getLogger("fungrasp.objects")
        for name in ("a.obj", "b.obj", "a.obj", "c.obj"):
            log.warning("%s: %s", name, "no thickness")
        for _ in range(3):
            log.warning("%d rollouts became unstable", 4)


def test_each_kind_is_told_once_and_names_all_that_it_is_about(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("warn", Warn, []) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines() == [
        "fungrasp: warning: a.obj: no thickness",
        "fungrasp: warning: 4 rollouts became unstable",
        "fungrasp: warning: also b.obj, c.obj: no thickness",
    ]
    assert not logging.getLogger("fungrasp").handlers


def test_retargeting_tells_each_fault_of_the_grasps_once_with_rows_and_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grasps = builtin_grasps().select(slice(0, 12))
    rest, joints = grasps.object_rest_pose.copy(), grasps.hand_joints.copy()
    rest[1, 2] += 0.03
    rest[3, 2] += 0.09
    joints[2, :, 2] -= 0.03 + joints[2, :, 2].min()
    pose = grasps.object_pose.copy()
    pose[2, 2] += joints[2, 0, 2] - grasps.hand_joints[2, 0, 2]
    file = tmp_path / "grasps.npz"
    fields = {"object_rest_pose": rest, "hand_joints": joints, "object_pose": pose}
    save_human_grasps(file, HumanGraspSet(**{**vars(grasps), **fields}))
    assert main(["retarget", "--grasps", str(file), "--out", str(tmp_path / "robot.npz"), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["count"] == 12
    warned = [line for line in said.err.splitlines() if "warning" in line]
    below, off = (line for line in warned if "table" in line)
    assert "grasp 2: the hand reaches 30 mm below the table" in below and "--below-table" in below
    assert "grasps 1, 3: at rest the object is up to 90 mm off the table: check" in off
    assert np.unique(warned).size == len(warned)
