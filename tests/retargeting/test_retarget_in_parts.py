"""Retargeting in parts: the same grasps, and an interrupted run goes on; a set knows its hand."""

from __future__ import annotations

import shutil
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import PartStore
from fungrasp.grasps import RobotGraspSet, load_robot_grasps, save_robot_grasps
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget

MODULE = import_module("fungrasp.retargeting.human_to_robot")


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(MODULE, "GRASPS_PER_PART", 2)


def solve(store: PartStore | None, method: str = "angle-copy", objects=None, **options) -> RobotGraspSet:
    chosen = plain_objects() if objects is None else objects
    return retarget(held(), chosen, "allegro", method, threads=1, store=store, **options)


def test_parts_are_the_whole(tmp_path, monkeypatch):
    counts: list[float] = []
    found = solve(PartStore(tmp_path / "parts"), progress=counts.append)
    monkeypatch.setattr(MODULE, "GRASPS_PER_PART", 1024)
    whole = solve(None)
    np.testing.assert_array_equal(found.joint_positions, whole.joint_positions)
    np.testing.assert_array_equal(found.wrist_pose, whole.wrist_pose)
    np.testing.assert_array_equal(found.object_name, whole.object_name)
    assert counts[0] == 0 and counts[-1] == 1 and counts == sorted(counts)
    assert len(list((tmp_path / "parts").iterdir())) == 3


def test_an_interrupted_run_goes_on(tmp_path, monkeypatch):
    store, expected = PartStore(tmp_path / "parts"), solve(None)

    def full(self, key: str, arrays: dict[str, np.ndarray]) -> None:
        raise FungraspError("the disk is full")

    kept = iter([PartStore.save, PartStore.save, full])
    monkeypatch.setattr(PartStore, "save", lambda *given: next(kept)(*given))
    with pytest.raises(FungraspError, match="disk is full"):
        solve(store)
    monkeypatch.undo()
    monkeypatch.setattr(MODULE, "GRASPS_PER_PART", 2)
    files = sorted((tmp_path / "parts").iterdir())
    files[0].write_bytes(files[0].read_bytes()[:100])

    def known(method: str = "angle-copy", objects=None) -> tuple[float, RobotGraspSet]:
        counts: list[float] = []
        found = solve(store, method, objects, progress=counts.append)
        return round(6 * counts[0]), found

    count, found = known()
    assert count == 2, "one part was kept, one is damaged, one was missing"
    np.testing.assert_allclose(found.joint_positions, expected.joint_positions, atol=1e-9)
    assert known()[0] == 6
    assert known("dexgraspnet")[0] == 0, "parts of another method are not taken"
    heavier = {name: replace(model, mass=2 * model.mass) for name, model in plain_objects().items()}
    assert known(objects=heavier)[0] == 0, "nor those of other objects"


def test_a_set_knows_a_hand_that_was_added(tmp_path):
    allegro = load_hand("allegro")
    folder = tmp_path / "mine"
    shutil.copytree(allegro.path.parent, folder)
    toml = folder / "hand.toml"
    toml.write_text(toml.read_text().replace('name = "allegro"', 'name = "mine"'))
    robot = retarget(held(), plain_objects(), folder, "angle-copy", threads=1)
    assert robot.hand == "mine" and Path(robot.hand_file) == toml
    save_robot_grasps(tmp_path / "robot.npz", robot)
    again = load_robot_grasps(tmp_path / "robot.npz")
    assert again.hand_file == robot.hand_file and again[0].hand_file == robot.hand_file
    assert again[1:3].load_hand().name == "mine"
    assert RobotGraspSet.concatenate([again, robot]).load_hand().joint_names == robot.joint_names
    toml.unlink()
    with pytest.raises(FungraspError, match=r"the hand .mine. of the grasps is not found: .* does not exist"):
        again.load_hand()


def test_a_set_of_a_hand_that_comes_with_the_package_names_no_file(tmp_path):
    robot = solve(None)
    assert robot.hand_file == "" and robot.load_hand().name == "allegro"
    with pytest.raises(FungraspError, match="of the hand 'allegro', not of 'leap'"):
        robot.check_hand(load_hand("leap"))
