"""Following a moving hand: where it ends, how smoothly it gets there, and what it does not touch."""

from __future__ import annotations

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.grasp_quality import static_quality
from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.correspondence import correspond
from fungrasp.retargeting import FollowedPose, Retargeter

FRAMES = 40
ROW = 2
"""A can, held from the side."""


def approach(retargeter: Retargeter, frames: int = FRAMES, distance: float = 0.08) -> list[FollowedPose]:
    """The hand comes in from a distance [m], more and more slowly, and stays for five frames."""
    grasp = held()[ROW]
    away = grasp.hand_joints[0] - grasp.object_pose[:3]
    away[2] = 0
    away /= np.linalg.norm(away)
    shares = [*np.linspace(1, 0, frames - 5) ** 2, *np.zeros(5)]
    return [retargeter.follow(grasp.hand_joints + distance * s * away, grasp.object_pose) for s in shares]


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_small_motions_of_the_person_are_small_motions_of_the_robot(name: str):
    poses = approach(Retargeter(load_hand(name), plain_objects()["can"]))
    joints = np.array([pose.joint_positions for pose in poses])
    wrists = np.array([pose.wrist_pose for pose in poses])
    # The person moves 5 mm at most from frame to frame.
    assert np.abs(np.diff(joints, axis=0)).max() < 0.2
    assert np.linalg.norm(np.diff(wrists[:, :3], axis=0), axis=1).max() < 0.015
    assert np.abs(joints[-1] - joints[-2]).max() < 0.02, "it comes to rest"


def test_it_ends_in_a_grasp_that_does_not_penetrate():
    hand, human, objects = load_hand("allegro"), held().select([ROW]), plain_objects()
    pose = approach(Retargeter(hand, objects["can"]))[-1]
    robot = RobotGraspSet(
        hand=hand.name,
        object_name=human.object_name,
        object_mass=human.object_mass,
        object_pose=human.object_pose,
        object_rest_pose=human.object_rest_pose,
        wrist_pose=pose.wrist_pose[None],
        joint_names=hand.joint_names,
        joint_positions=pose.joint_positions[None],
        keypoints=np.zeros((1, len(hand.keypoint_names), 3)) + human.object_pose[0, :3],
        link_contacts=correspond(hand).link_contacts(human.link_contacts),
    )
    quality = static_quality(robot, human, objects, hand)
    assert quality.object_penetration_mm[0] < 2.0
    assert quality.table_penetration_mm[0] < 1.0
    assert quality.contact_error_mm[0] < 15.0
    assert np.all(pose.joint_positions >= hand.joint_limits[:, 0] - 1e-9)
    assert np.all(pose.joint_positions <= hand.joint_limits[:, 1] + 1e-9)


def test_the_whole_scene_may_be_turned_on_the_table():
    """Turned about the vertical and shifted along the table, hand and object give the same hand, moved."""
    grasp, hand = held()[ROW], load_hand("allegro")
    move = np.array([0.3, -0.2, 0.0, np.cos(0.4), 0.0, 0.0, np.sin(0.4)])
    one = Retargeter(hand, plain_objects()["can"]).follow(grasp.hand_joints, grasp.object_pose)
    other = Retargeter(hand, plain_objects()["can"]).follow(
        transform_points(move, grasp.hand_joints), compose(move, grasp.object_pose)
    )
    np.testing.assert_allclose(one.joint_positions, other.joint_positions, atol=1e-3)
    np.testing.assert_allclose(compose(move, one.wrist_pose)[:3], other.wrist_pose[:3], atol=1e-3)


def test_reset_forgets():
    grasp, hand = held()[ROW], load_hand("allegro")
    retargeter = Retargeter(hand, plain_objects()["can"])
    first = retargeter.follow(grasp.hand_joints, grasp.object_pose)
    retargeter.follow(grasp.hand_joints + 0.02, grasp.object_pose)
    retargeter.reset()
    again = retargeter.follow(grasp.hand_joints, grasp.object_pose)
    np.testing.assert_array_equal(first.joint_positions, again.joint_positions)


def test_what_is_not_a_hand_is_refused():
    grasp = held()[ROW]
    retargeter = Retargeter(load_hand("allegro"), plain_objects()["can"])
    with pytest.raises(FungraspError, match=r"hand_joints must be finite numbers of shape \(21, 3\)"):
        retargeter.follow(grasp.hand_joints[:20], grasp.object_pose)
    with pytest.raises(FungraspError, match="object_pose"):
        retargeter.follow(grasp.hand_joints, np.full(7, np.nan))
