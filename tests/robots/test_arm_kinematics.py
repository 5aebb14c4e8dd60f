"""From poses of the palm to joints of the arm."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from robot_cells import cell_and_hand

from fungrasp.geometry.poses import compose, relative, rotate, rotation_vector
from fungrasp.hands.arm import Mount, mounting_pose
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import Workspace
from fungrasp.robots.kinematics.arm_model import MARGIN, ArmKinematics, Clearance, ClearanceModel
from fungrasp.robots.kinematics.joint_path import OBJECT_CLEAR, FreePath, timed_leg
from fungrasp.robots.kinematics.reach import arm_postures, random_starts

POSTURE = np.array([0.2, -1.4, 1.6, -1.5, -1.5, 0.3])


@pytest.fixture(scope="module")
def kinematics() -> ArmKinematics:
    return ArmKinematics(*cell_and_hand())


def test_jacobian_is_the_derivative_of_the_pose(kinematics: ArmKinematics) -> None:
    jacobian, step = kinematics.jacobian(POSTURE), 1e-6
    for joint in range(6):
        moved = POSTURE.copy()
        moved[joint] += step
        difference = kinematics.palm_pose(moved)[:3] - kinematics.palm_pose(POSTURE)[:3]
        np.testing.assert_allclose(difference / step, jacobian[:3, joint], atol=1e-5)


def test_a_ur_has_eight_postures_for_a_pose(kinematics: ArmKinematics) -> None:
    pose = kinematics.palm_pose(POSTURE)
    found = arm_postures(kinematics, pose, random_starts(kinematics, 48, np.random.default_rng(0)))
    assert len(found) == 8
    assert min(np.abs(found - POSTURE).max(axis=1)) < 1e-3
    for joints in found:
        np.testing.assert_allclose(kinematics.palm_pose(joints)[:3], pose[:3], atol=1e-4)


def test_no_posture_for_a_pose_out_of_reach(kinematics: ArmKinematics) -> None:
    pose = kinematics.palm_pose(POSTURE)
    pose[0] += 2.0
    assert len(arm_postures(kinematics, pose, random_starts(kinematics, 8, np.random.default_rng(0)))) == 0


def test_the_palm_is_followed_on_one_branch(kinematics: ArmKinematics) -> None:
    pytest.importorskip("mink")
    from fungrasp.robots.kinematics.reach import PalmFollower

    follower = PalmFollower(kinematics, 2.0)
    follower.begin(POSTURE)
    pose, before = kinematics.palm_pose(POSTURE), POSTURE
    for _ in range(40):
        pose[0] += 0.004
        joints, place, turn = follower.follow(pose, 0.02)
        assert max(place, turn) < 1e-4
        assert np.abs(joints - before).max() <= 2.0 * 0.02 * 1.001
        before = joints
    error = relative(kinematics.palm_pose(before), pose)
    assert np.linalg.norm(error[:3]) < 1e-4
    assert np.linalg.norm(rotation_vector(error[3:])) < 1e-4


def test_a_follower_keeps_the_joint_speed_where_the_palm_jumps(kinematics: ArmKinematics) -> None:
    pytest.importorskip("mink")
    from fungrasp.robots.kinematics.reach import PalmFollower

    follower = PalmFollower(kinematics, 0.5)
    follower.begin(POSTURE)
    pose = kinematics.palm_pose(POSTURE)
    pose[1] += 0.2
    joints, place, _ = follower.follow(pose, 0.02)
    assert np.abs(joints - POSTURE).max() <= 0.5 * 0.02 * 1.001
    assert place > 0.1


def test_legs_keep_the_limits_of_joints_and_palm(kinematics: ArmKinematics) -> None:
    cell, _ = cell_and_hand()
    end = POSTURE + np.array([1.0, 0.2, -0.4, 0.5, 0.3, -1.2])
    path = timed_leg(POSTURE, end, kinematics, cell.limits, 0.02)
    np.testing.assert_array_equal(path[-1], end)
    joints = np.concatenate([POSTURE[None], path])
    palm = np.array([kinematics.palm_pose(q)[:3] for q in joints])
    assert np.abs(np.diff(joints, axis=0)).max() / 0.02 <= cell.limits.arm_speed
    assert np.linalg.norm(np.diff(palm, axis=0), axis=1).max() / 0.02 <= cell.limits.palm_speed
    assert np.linalg.norm(np.diff(palm, 2, axis=0), axis=1).max() / 4e-4 <= cell.limits.palm_acceleration


def test_clearance_sees_table_and_arm() -> None:
    cell, hand = cell_and_hand()
    model, fingers = ClearanceModel(cell, hand), np.zeros(16)
    home = model.measure(np.array(cell.arm.home), fingers)
    assert min(home.table, home.hand, home.itself) > 0.0
    assert model.measure(np.array([0.0, 0.6, 0.1, 0, 0, 0]), fingers).table < 0.0
    assert model.measure(np.array([0.0, -1.57, 2.9, -1.57, -1.57, 0.0]), fingers).itself < 0.0


def box(size: list[float]) -> ObjectModel:
    mesh = trimesh.creation.box(size)
    return ObjectModel("box", 0.2, mesh.vertices, mesh.faces)


def test_distance_to_the_object_in_the_posture_that_was_measured(kinematics: ArmKinematics) -> None:
    cell, hand = cell_and_hand()
    model, fingers = ClearanceModel(cell, hand, box([0.04, 0.04, 0.04])), np.zeros(16)
    palm = kinematics.palm_pose(POSTURE)
    model.place_object(palm)
    model.measure(POSTURE, fingers)
    assert model.distance_to_object() < 0.0
    away = palm.copy()
    away[2] -= 1.0
    model.place_object(away)
    model.measure(POSTURE, fingers)
    assert model.distance_to_object() == MARGIN


def test_a_way_around_an_object(kinematics: ArmKinematics) -> None:
    cell, hand = cell_and_hand()
    free = FreePath(kinematics, ClearanceModel(cell, hand, box([0.1, 0.1, 0.1])), cell.workspace)
    fingers, rng = np.zeros(16), np.random.default_rng(0)
    start = np.array(cell.arm.home)
    end = start + np.array([1.0, 0, 0, 0, 0, 0])
    pose = np.array([0.0, 0, 0, 1, 0, 0, 0])
    pose[:3] = kinematics.palm_pose(0.5 * (start + end))[:3] - [0, 0, 0.12]
    assert free.find(start, end, fingers, None, rng) == [end]
    way = free.find(start, end, fingers, pose, rng)
    assert way is not None and len(way) > 1
    np.testing.assert_array_equal(way[-1], end)
    for one, other in zip([start, *way[:-1]], way, strict=True):
        assert all(free.clear(q, fingers, OBJECT_CLEAR) for q in np.linspace(one, other, 12))


def test_a_hand_may_begin_beside_a_long_object(kinematics: ArmKinematics) -> None:
    """Nearer than half its length, and nearer than the distance that is kept elsewhere."""
    cell, hand = cell_and_hand()
    long = box([0.6, 0.04, 0.04])
    clearance = ClearanceModel(cell, hand, long)
    free, fingers = FreePath(kinematics, clearance, cell.workspace), np.zeros(16)
    start = np.array(cell.arm.home)
    end = start + np.array([0.6, 0, 0, 0, 0, 0])
    pose = np.array([0.0, 0, 0, 1, 0, 0, 0])
    pose[:3] = kinematics.palm_pose(end)[:3]
    distance = -1.0
    while distance < 0.005:
        pose[2] -= 0.005
        clearance.place_object(pose)
        clearance.measure(end, fingers)
        distance = clearance.distance_to_object()
    assert distance < OBJECT_CLEAR
    way = free.find(start, end, fingers, pose, np.random.default_rng(0))
    assert way is not None
    for one, other in zip([start, *way[:-1]], way, strict=True):
        assert all(free.clear(q, fingers, distance - 1e-6) for q in np.linspace(one, other, 12))


def test_the_palm_is_where_the_cell_says_that_the_hand_is_mounted(kinematics: ArmKinematics) -> None:
    """On an adapter of 156 mm, turned by 90 degrees about the flange's axis."""
    cell, hand = cell_and_hand()
    mount = Mount((0.0, 0.0, 0.156, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))
    pose = mounting_pose(hand, mount)
    np.testing.assert_allclose(rotate(pose[3:], hand.palm_normal), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(pose[2] - mounting_pose(hand)[2], 0.155, atol=1e-9)
    mounted = ArmKinematics(replace(cell, mount=mount), hand).palm_pose(POSTURE)
    moved = compose(relative(mounting_pose(hand), pose), np.array([0, 0, 0, 1, 0, 0, 0]))
    np.testing.assert_allclose(mounted[:3], compose(kinematics.palm_pose(POSTURE), moved)[:3], atol=1e-9)


def test_the_adapter_keeps_its_distance_from_the_table() -> None:
    """The flange points straight down; the hand is far to the side, so that only the adapter comes near."""
    cell, hand = cell_and_hand()
    base = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    down = np.array([0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0])
    aside = (0.0, 0.0, -0.5, 1.0, 0.0, 0.0, 0.0)
    cell = replace(cell, arm=replace(cell.arm, pose_world_base=base), mount=Mount(aside))
    flange = ArmKinematics(cell, hand).palm_pose(down)[2] + mounting_pose(hand, cell.mount)[2]
    fingers = hand.open_joints
    bare = ClearanceModel(cell, hand).measure(down, fingers)
    assert bare.table == MARGIN
    longer = replace(cell, mount=Mount(aside, adapter_radius=0.04, adapter_length=float(flange) - 0.01))
    assert ClearanceModel(longer, hand).measure(down, fingers).table == pytest.approx(0.01, abs=1e-3)


def test_a_plan_keeps_the_hand_farther_from_the_table_than_motion_must() -> None:
    box, near = Workspace(hand_depth=-0.005), Clearance(hand=0.006)
    assert not near.fault(box) and not Clearance(hand=0.008).fault(box, room=0.005)
    assert "the hand would press into the table" in near.fault(box, room=0.005)
