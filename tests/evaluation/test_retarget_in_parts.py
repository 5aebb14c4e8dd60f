"""Retargeting in parts: the same grasps, and an interrupted run goes on."""

from __future__ import annotations

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.errors import FungraspError
from fungrasp.evaluation import retarget_in_parts as module
from fungrasp.evaluation import static_quality
from fungrasp.evaluation.retarget_in_parts import remove_parts, retarget_in_parts
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget


def solve(folder, method: str = "angle-copy", progress=lambda count: None, size: int = 2):
    return retarget_in_parts(held(), plain_objects(), load_hand("allegro"), method, 1, folder, progress, size)


def test_parts_are_the_whole(tmp_path):
    counts: list[int] = []
    found = solve(tmp_path / "parts", progress=counts.append)
    whole = retarget(held(), plain_objects(), load_hand("allegro"), "angle-copy", threads=1)
    np.testing.assert_allclose(found.robot.joint_positions, whole.joint_positions, atol=1e-9)
    np.testing.assert_array_equal(found.robot.object_name, whole.object_name)
    quality = static_quality(whole, held(), plain_objects(), load_hand("allegro"))
    np.testing.assert_allclose(found.quality.contact_error_mm, quality.contact_error_mm, atol=1e-6)
    assert sum(counts) == found.solved == 6
    assert len(list((tmp_path / "parts").iterdir())) == 3
    remove_parts(tmp_path / "parts")
    assert not (tmp_path / "parts").exists()


def test_an_interrupted_run_goes_on(tmp_path, monkeypatch):
    folder = tmp_path / "parts"
    expected = solve(tmp_path / "others")

    def full(path, robot: RobotGraspSet) -> None:
        raise FungraspError("the disk is full")

    kept = iter([module.save_robot_grasps, module.save_robot_grasps, full])
    monkeypatch.setattr(module, "save_robot_grasps", lambda *given: next(kept)(*given))
    with pytest.raises(FungraspError, match="disk is full"):
        solve(folder)
    monkeypatch.undo()
    files = sorted(folder.iterdir())
    files[0].write_bytes(files[0].read_bytes()[:100])
    found = solve(folder)
    assert found.solved == 4, "one part was kept, one is damaged, one was missing"
    np.testing.assert_allclose(found.robot.joint_positions, expected.robot.joint_positions, atol=1e-6)
    assert solve(folder).solved == 0
    assert solve(folder, "dexgraspnet").solved == 6, "parts of another method are not taken"


def test_few_grasps_leave_no_folder(tmp_path):
    solve(tmp_path / "parts", size=1024)
    assert not (tmp_path / "parts").exists()
