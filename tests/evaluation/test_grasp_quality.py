"""Static quality against dense points on the exported hand and exact distances (``surface_samples``)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from surface_samples import PlacedHand, convex_distance, matrix, nearest_point

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import static_quality
from fungrasp.evaluation.grasp_quality import with_quality
from fungrasp.geometry.poses import compose
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_objects
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget

FAR = 2.0
"""Beyond this [mm] only the order of magnitude of a mean gap matters."""


@pytest.fixture(scope="module")
def human() -> HumanGraspSet:
    """Of convex built-in objects."""
    grasps = builtin_grasps()
    rows = [np.flatnonzero(grasps.object_name == name)[i] for name in ("tennis_ball", "box") for i in (0, 2)]
    return grasps.select(rows)


@pytest.fixture(scope="module")
def objects(human):
    return load_objects(human)


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def robot(human, objects, hand):
    return retarget(human, objects, hand)


@pytest.mark.parametrize(("name", "method"), [("allegro", "contact"), ("inspire", "angle-copy")])
def test_numbers_are_those_of_dense_points_on_the_exported_model(name, method, human, objects):
    hand = load_hand(name)
    robot = retarget(human, objects, hand, method)
    quality = static_quality(robot, human, objects, hand)
    random = np.random.default_rng(0)
    for row, grasp in enumerate(robot):
        placed = PlacedHand(hand, grasp)
        obj, world = objects[grasp.object_name], matrix(grasp.object_pose)
        points, bodies = placed.surface(random)
        local = (points - world[:3, 3]) @ world[:3, :3]
        distance = convex_distance(obj, local)
        assert quality.object_penetration_mm[row] == pytest.approx(-1e3 * min(distance.min(), 0), abs=0.25)
        gaps = np.array([max(distance[np.isin(bodies, link)].min(), 0.0) for link in hand.links])
        wanted = grasp.link_contacts & (np.arange(len(gaps)) > 0)
        gap = 1e3 * gaps[wanted].mean()
        if gap < FAR:
            assert quality.contact_gap_mm[row] == pytest.approx(gap, abs=0.15)
        else:
            assert quality.contact_gap_mm[row] > FAR
        rest = matrix(grasp.object_rest_pose)
        lowest = (local @ rest[:3, :3].T + rest[:3, 3])[:, 2].min()
        assert quality.table_penetration_mm[row] == pytest.approx(-1e3 * min(lowest, 0), abs=0.15)


def test_contact_error_and_directions_of_fingers_by_hand(human, objects, hand, robot):
    """For a hand whose links stand for human links one by one."""
    quality = static_quality(robot, human, objects, hand)
    fingers = {"index": 0, "middle": 1, "ring": 2, "thumb": 4}
    for row, grasp in enumerate(robot):
        placed, obj, world = PlacedHand(hand, grasp), objects[grasp.object_name], matrix(grasp.object_pose)
        person = human[row]
        errors, angles = [], []
        for name, place in fingers.items():
            finger = hand.fingers[name]
            joints = [placed.point(point) for point in (*finger.joints, finger.tip)]
            own = person.hand_joints[1 + 4 * place : 5 + 4 * place]
            for link in range(3):
                robot_link, human_link = joints[link + 1] - joints[link], own[link + 1] - own[link]
                cosine = robot_link @ human_link / np.linalg.norm(robot_link) / np.linalg.norm(human_link)
                angles.append(np.degrees(np.arccos(cosine)))
                if person.link_contacts[1 + 3 * place + link]:
                    ends = (np.array([joints[link + 1], own[link + 1]]) - world[:3, 3]) @ world[:3, :3]
                    errors.append(1e3 * np.linalg.norm(np.subtract(*nearest_point(obj, ends))))
        assert quality.contact_error_mm[row] == pytest.approx(np.mean(errors), abs=0.3)
        assert quality.link_direction_error_deg[row] == pytest.approx(np.mean(angles), abs=0.01)


def test_moving_the_whole_scene_changes_nothing(human, objects, hand, robot):
    move = np.array([0.1, -0.2, 0.3, np.cos(0.4), 0.0, np.sin(0.4), 0.0])
    moved_robot = dataclasses.replace(
        robot, object_pose=compose(move, robot.object_pose), wrist_pose=compose(move, robot.wrist_pose)
    )
    joints = human.hand_joints.reshape(-1, 3)
    poses = np.concatenate([joints, np.tile([1.0, 0, 0, 0], (len(joints), 1))], axis=1)
    moved_human = dataclasses.replace(
        human,
        object_pose=compose(move, human.object_pose),
        hand_joints=compose(move, poses)[:, :3].reshape(human.hand_joints.shape),
    )
    one = static_quality(robot, human, objects, hand)
    other = static_quality(moved_robot, moved_human, objects, hand)
    for field in dataclasses.fields(one):
        np.testing.assert_allclose(getattr(one, field.name), getattr(other, field.name), atol=1e-5)


def test_limits_and_the_hand_itself(human, objects, hand, robot):
    positions = robot.joint_positions.copy()
    positions[0, 1] = hand.joint_limits[1, 1] + 0.25
    positions[1] = np.where(np.isfinite(hand.joint_limits[:, 1]), hand.joint_limits[:, 1], 0.0)
    quality = static_quality(dataclasses.replace(robot, joint_positions=positions), human, objects, hand)
    assert quality.limit_violation_rad[0] == pytest.approx(0.25)
    assert (quality.limit_violation_rad[1:] == 0).all()
    assert quality.self_penetration_mm[1] > 1.0


def test_a_summary_leaves_out_what_was_not_measured(human, objects, hand, robot):
    untouched = dataclasses.replace(human, link_contacts=np.zeros_like(human.link_contacts))
    quality = static_quality(robot, untouched, objects, hand)
    assert np.isnan(quality.contact_error_mm).all()
    summary = quality.summary()
    assert "contact_error_mm" not in summary
    assert summary["object_penetration_mm"]["max"] >= summary["object_penetration_mm"]["p95"] >= 0


def test_sets_that_do_not_belong_together(human, objects, hand, robot):
    with pytest.raises(FungraspError, match="same order"):
        static_quality(robot.select([1, 0, 2, 3]).select([3, 2, 1, 0]), human, objects, hand)
    with pytest.raises(FungraspError, match="of the hand 'allegro', not of 'leap'"):
        static_quality(robot, human, objects, load_hand("leap"))


def test_the_solvers_distances_are_a_millimeter_off_at_most(human, objects, hand, robot):
    exact, quick = (static_quality(robot, human, objects, hand, exact=which) for which in (True, False))
    assert np.isnan(quick.force_closure_epsilon).all() and np.isfinite(exact.force_closure_epsilon).all()
    for name in ("contact_gap_mm", "object_penetration_mm"):
        difference = np.abs(getattr(exact, name) - getattr(quick, name))
        assert 0 < difference.max() < 1.0
    np.testing.assert_allclose(quick.contact_error_mm, exact.contact_error_mm, atol=1e-6)
    np.testing.assert_array_equal(quick.held_as_shown, exact.held_as_shown)
    assert "force_closure_epsilon" not in with_quality(robot, quick).extra
