"""Following a moving hand: where it ends, how smoothly it gets there, and what it does not touch."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.grasp_quality import static_quality
from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.human_hand import OPENPOSE, mirror_points
from fungrasp.hands import load_hand
from fungrasp.hands.collisions import self_collision_depth
from fungrasp.hands.correspondence import correspond
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.retargeting import FollowedPose, Retargeter, RetargeterSettings
from fungrasp.retargeting.retargeter import OneEuroFilter

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
    with pytest.raises(FungraspError, match="only there"):
        retargeter.follow(grasp.hand_joints)
    with pytest.raises(FungraspError, match="only there"):
        Retargeter("allegro").follow(grasp.hand_joints, grasp.object_pose)
    with pytest.raises(FungraspError, match="unknown order of joints"):
        Retargeter("allegro", order="mediapip")
    with pytest.raises(FungraspError, match="rate must be positive, not 0"):
        RetargeterSettings(rate=0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda joints: 1000 * joints, "joints are in mm, not m; follow takes meters"),
        (lambda joints: joints[np.argsort(OPENPOSE)], r"order of openpose .* Retargeter\(order"),
        (mirror_points, "bend backwards for a right hand, the side of 'allegro'; mirror the joints"),
    ],
)
def test_another_convention_is_refused_at_the_first_frame_that_shows_it(change, message):
    flat, bent = straightened(held().hand_joints[0]), held().hand_joints[0]
    retargeter = Retargeter("allegro")
    with pytest.raises(FungraspError, match=message):
        retargeter.follow(change(bent))
    with pytest.raises(FungraspError, match=message):
        retargeter.follow(change(flat))
        retargeter.follow(change(bent))
    retargeter.reset()
    retargeter.follow(flat)


def straightened(joints: np.ndarray) -> np.ndarray:
    """The hand with straight fingers, each along its first bone [m]."""
    flat = joints.copy()
    for base in range(1, 17, 4):
        along = (joints[base] - joints[0]) / np.linalg.norm(joints[base] - joints[0])
        lengths = np.linalg.norm(np.diff(joints[base : base + 4], axis=0), axis=1)
        flat[base + 1 : base + 4] = joints[base] + np.cumsum(lengths)[:, None] * along
    return flat


def gestures(frames: int = 60) -> np.ndarray:
    """A free hand that opens and closes between the postures of three grasps while it moves and turns [m]."""
    posture = held().hand_joints[:3] - held().hand_joints[:3, :1]
    found = []
    for share in np.linspace(0.0, 1.999, frames):
        first, part = int(share), share % 1
        turn = np.array([0.3 * share, 0.0, 0.2, np.cos(0.5 * share), 0.0, 0.0, np.sin(0.5 * share)])
        found.append(transform_points(turn, (1 - part) * posture[first] + part * posture[first + 1]))
    return np.array(found)


@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_a_free_hand_is_followed_at_more_than_100_frames_a_second(name: str):
    retargeter, seen = Retargeter(name), gestures()
    retargeter.follow(seen[0])
    retargeter.follow(seen[1])
    start = process_time()
    poses = [retargeter.follow(joints) for joints in seen[2:]]
    assert len(poses) / (process_time() - start) > 100
    hand = retargeter.hand
    joints = np.array([pose.joint_positions for pose in poses])
    assert np.all((joints >= hand.joint_limits[:, 0] - 1e-9) & (joints <= hand.joint_limits[:, 1] + 1e-9))
    assert np.abs(np.diff(joints, axis=0)).max() < 0.2
    points, match = HandPoints(HandKinematics(hand, len(poses))), correspond(hand)
    points.kinematics.update(np.array([pose.wrist_pose for pose in poses]), hand.independent(joints))
    tips = points.kinematics.points(points.keypoints)[:, match.far[match.is_last]]
    wanted = seen[2:][:, match.human_far[match.is_last]]
    assert np.linalg.norm(tips - wanted, axis=-1).mean() < 0.008
    assert self_collision_depth(hand.model, joints).max() < 0.004


def test_a_hand_at_rest_is_followed_without_the_noise_of_the_tracker():
    rng, rest = np.random.default_rng(0), gestures(1)[0]
    seen = rest + 0.002 * rng.normal(size=(40, *rest.shape))
    jitter = []
    for rate in (30.0, None):
        retargeter = Retargeter("allegro", settings=RetargeterSettings(rate=rate))
        joints = np.array([retargeter.follow(frame).joint_positions for frame in seen])
        jitter.append(np.diff(joints[10:], n=2, axis=0).std())
    assert jitter[0] < 0.4 * jitter[1]


def test_smoothing_lags_by_no_more_than_its_distance():
    smooth, lag = OneEuroFilter(rate=30.0, cutoff=1.0, lag=0.004), 0.0
    for frame in range(60):
        point = np.array([[0.5 * frame / 30.0, 0.0, 0.0]])  # 0.5 m/s
        lag = float(np.linalg.norm(point - smooth(point)))
    assert 0.001 < lag < 0.004


def test_a_free_hand_may_be_anywhere_and_in_any_order():
    move = np.array([0.5, -0.2, 1.0, 0.5, 0.5, -0.5, 0.5])
    plain, moved = Retargeter("allegro"), Retargeter("allegro", order="mediapipe")
    for joints in gestures()[::20]:
        scattered = np.empty((21, 3))
        scattered[OPENPOSE] = transform_points(move, joints)
        one, other = plain.follow(joints), moved.follow(scattered)
        np.testing.assert_allclose(one.joint_positions, other.joint_positions, atol=1e-3)
        np.testing.assert_allclose(compose(move, one.wrist_pose)[:3], other.wrist_pose[:3], atol=1e-3)
