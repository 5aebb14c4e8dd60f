"""Human grasps in, robot grasps out, through the public door."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from retarget_scenes import ROBOTS, SHARED, held, moved, plain_objects
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import UnknownNameError
from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, load_objects
from fungrasp.grasps.grasp_files import load_human_grasps
from fungrasp.hands import load_hand
from fungrasp.retargeting import METHODS, retarget

DEXYCB, YCB = SHARED / "data" / "dexycb_train.npz", SHARED / "data" / "ycb"
needs_dexycb = pytest.mark.skipif(
    not (DEXYCB.is_file() and YCB.is_dir()), reason=f"the DexYCB grasps are not in {SHARED / 'data'}"
)


MODULE = import_module("fungrasp.retargeting.human_to_robot")


@cache
def solved(
    name: str, method: str = "contact", grasps: HumanGraspSet | None = None, chunk: int = 64, **options
) -> RobotGraspSet:
    options = {"threads": 1, **options}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MODULE, "CHUNK", chunk)
        human = held() if grasps is None else grasps
        return retarget(human, plain_objects(), load_hand(name), method, **options)


@cache
def quality(name: str, method: str = "contact") -> StaticQuality:
    robot = solved(name, method)
    return static_quality(robot, held(), plain_objects(), load_hand(name))


def assert_same(a: RobotGraspSet, b: RobotGraspSet, atol: float) -> None:
    """The same grasps relative to the object, whatever the world."""
    np.testing.assert_allclose(a.joint_positions, b.joint_positions, atol=atol)
    for one, other in zip(a.wrist_pose_object, b.wrist_pose_object, strict=True):
        np.testing.assert_allclose(one[:3], other[:3], atol=atol)
        np.testing.assert_allclose(abs(one[3:] @ other[3:]), 1.0, atol=atol)
    np.testing.assert_array_equal(a.link_contacts, b.link_contacts)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ROBOTS)
def test_every_method_gives_every_hand_a_possible_grasp(name: str, method: str):
    hand, robot = load_hand(name), solved(name, method)
    assert robot.hand == name
    assert robot.joint_names == hand.joint_names
    assert np.all(robot.joint_positions >= hand.joint_limits[:, 0] - 1e-9)
    assert np.all(robot.joint_positions <= hand.joint_limits[:, 1] + 1e-9)
    matrix, offset = hand.coupling
    free = [hand.joint_names.index(joint) for joint in hand.actuators]
    coupled = robot.joint_positions[:, free] @ matrix.T + offset
    np.testing.assert_allclose(robot.joint_positions, coupled, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(robot.wrist_pose[:, 3:], axis=1), 1.0, atol=1e-9)
    assert np.all(np.linalg.norm(robot.wrist_pose[:, :3] - robot.object_pose[:, :3], axis=1) < 0.35)


@pytest.mark.parametrize("name", ROBOTS)
def test_ours_touches_where_the_human_did(name: str):
    found = quality(name)
    assert np.all(found.held_as_shown) and found.other_side.max() == 0
    assert found.place_error_mm.mean() < 6
    assert found.contact_gap_mm.mean() < 1
    assert found.link_direction_error_deg.mean() < (40 if name == "inspire" else 30)
    assert found.object_penetration_mm.max() < 2
    assert found.table_penetration_mm.max() < 0.5
    assert found.self_penetration_mm.max() < 1
    assert found.limit_violation_rad.max() < 1e-9


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_ours_is_nearer_to_the_human_contacts_than_the_baselines(name: str):
    theirs = [quality(name, method).place_error_mm.mean() for method in ("angle-copy", "dexgraspnet")]
    assert quality(name).place_error_mm.mean() < 0.6 * min(theirs)


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_the_baselines_keep_the_posture_or_touch_without_penetrating(name: str):
    assert quality(name, "angle-copy").link_direction_error_deg.mean() < 22
    found = quality(name, "dexgraspnet")
    assert found.contact_gap_mm.mean() < 3
    assert found.object_penetration_mm.mean() < 2


def test_angle_copy_gives_the_human_hand_its_own_angles_back():
    """About: the joints of the human hand are not exactly hinges of the anatomist's kind."""
    robot = solved("human", "angle-copy")
    fingers = [i for i, joint in enumerate(robot.joint_names) if not joint.startswith("thumb")]
    assert quality("human", "angle-copy").link_direction_error_deg.mean() < 8
    ours = solved("human")
    assert np.abs(robot.joint_positions - ours.joint_positions)[:, fingers].mean() < np.radians(10)


@pytest.mark.parametrize("method", METHODS)
def test_moving_the_scene_about_the_vertical_moves_the_grasp(method: str):
    turn = Rotation.from_euler("z", 1.1).as_quat(scalar_first=True)
    elsewhere = moved(held(), np.concatenate([[0.4, -0.3, 0.0], turn]))
    assert_same(solved("allegro", method), solved("allegro", method, elsewhere), atol=1e-3)


@pytest.mark.parametrize("method", ["angle-copy", "dexgraspnet"])
def test_the_baselines_do_not_know_which_way_is_up(method: str, monkeypatch: pytest.MonkeyPatch):
    # A world whose table is tilted is refused before any method sees it.
    verb = import_module("fungrasp.retargeting.human_to_robot")
    monkeypatch.setattr(verb, "checked_grasps", lambda arrays, *_, **__: HumanGraspSet(**arrays))
    turn = Rotation.from_euler("xyz", [1.0, 0.6, -2.0]).as_quat(scalar_first=True)
    elsewhere = moved(held(), np.concatenate([[0.1, 0.2, 0.5], turn]))
    assert_same(solved("leap", method), solved("leap", method, elsewhere), atol=1e-3)


def test_where_the_object_is_held_does_not_matter():
    """The hand goes with the object; the table is where the object rests."""
    turn = Rotation.from_euler("xyz", [0.5, -0.8, 2.0]).as_quat(scalar_first=True)
    lifted = moved(held(), np.concatenate([[0.1, 0.2, 0.6], turn]))
    lifted = replace(lifted, object_rest_pose=held().object_rest_pose)
    assert_same(solved("allegro"), solved("allegro", grasps=lifted), atol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_threads_do_not_change_the_result(method: str):
    one, many = (solved("inspire", method, threads=threads, chunk=2) for threads in (1, 3))
    np.testing.assert_array_equal(one.joint_positions, many.joint_positions)
    np.testing.assert_array_equal(one.wrist_pose, many.wrist_pose)
    np.testing.assert_array_equal(one.keypoints, many.keypoints)


@pytest.mark.parametrize("method", METHODS)
def test_grasps_solved_together_do_not_matter_to_each_other(method: str):
    assert_same(solved("inspire", method), solved("inspire", method, chunk=1), atol=1e-3)


def test_result_carries_the_grasp_over():
    human, progress = held(), []
    robot = solved("shadow", chunk=4, progress=progress.append)
    assert progress[0] == 0 and progress[1] in (1 / 3, 2 / 3) and progress[-1] == 1
    for name in ("object_name", "object_mass", "object_pose", "object_rest_pose", "task"):
        np.testing.assert_array_equal(getattr(robot, name), getattr(human, name))
    hand = load_hand("shadow")
    assert robot.keypoints.shape == (6, len(hand.keypoint_names), 3)
    np.testing.assert_allclose(robot.keypoints[:, 0], robot.wrist_pose[:, :3], atol=1e-9)
    assert robot.link_contacts.shape == (6, len(hand.links))


def test_unknown_method():
    with pytest.raises(UnknownNameError, match=r"retargeting method 'angle_copy'.*Did you mean 'angle-copy'"):
        solved("allegro", "angle_copy")


@needs_dexycb
@pytest.mark.slow
def test_quality_on_real_grasps():
    human = load_human_grasps(DEXYCB).select(slice(0, None, 10))
    objects, hand = load_objects(human, YCB), load_hand("allegro")
    found = static_quality(retarget(human, objects, hand, threads=1), human, objects, hand).summary()
    assert found["held_as_shown"]["mean"] >= 0.9 and found["place_error_mm"]["mean"] <= 7.5
    assert found["contact_gap_mm"]["mean"] <= 2
    assert found["link_direction_error_deg"]["mean"] <= 25
    assert found["object_penetration_mm"]["mean"] <= 2
    assert found["object_penetration_mm"]["p95"] <= 5
    assert found["table_penetration_mm"]["max"] <= 2
    assert found["limit_violation_rad"]["max"] <= 1e-9
