"""Other packages on the same grasps: the hand they read is ours, and what they give is judged alike."""

from __future__ import annotations

from importlib.util import find_spec

import mujoco
import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from benchmarks.peers.comparison import PEERS, compare_method, installed_peers
from benchmarks.peers.following import FOLLOWERS, measure, moving_hand
from benchmarks.peers.position_solvers import hand_urdf
from benchmarks.peers.problem import PeerProblem
from fungrasp.grasps.human_hand import bone_lengths
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics


@pytest.mark.parametrize("name", ["allegro", "shadow", "inspire", "leap", "faive"])
def test_the_urdf_is_the_hand(name: str):
    hand = load_hand(name)
    spec = mujoco.MjSpec.from_string(hand_urdf(hand))
    spec.compiler.fusestatic = False
    model = spec.compile()
    kinematics = HandKinematics(hand, 1)
    independent = kinematics.lower + np.random.default_rng(0).random(len(kinematics.lower)) * (
        kinematics.upper - kinematics.lower
    )
    kinematics.update(None, independent[None])
    expected = kinematics.points(kinematics.body_points(hand.keypoint_names))[0]
    data = mujoco.MjData(model)
    for joint, angle in zip(hand.joint_names, hand.all_joints(independent), strict=True):
        data.qpos[model.jnt_qposadr[model.joint(joint).id]] = angle
    mujoco.mj_kinematics(model, data)
    names = [model.body(b).name for b in range(model.nbody)]
    found = [data.xpos[names.index(n)] for n in hand.keypoint_names]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_solution_is_brought_within_limits():
    hand = load_hand("inspire")
    problem = PeerProblem.of(held(), plain_objects(), hand)
    wild = np.full((len(held()), len(hand.joint_names)), 9.0)
    robot = problem.solved(problem.wrist_start, wild)
    assert np.all(robot.joint_positions <= hand.joint_limits[:, 1] + 1e-9)
    np.testing.assert_allclose(
        robot.joint_positions, hand.all_joints(hand.independent(robot.joint_positions)), atol=1e-9
    )


@pytest.mark.parametrize("name", list(PEERS))
def test_a_peer_brings_the_fingers_to_the_object(name: str):
    if name not in installed_peers():
        pytest.skip(f"{name} is not installed (extra 'bench')")
    human = held().select([2, 3])
    result = compare_method(name, human, plain_objects(), load_hand("allegro"))
    assert result.cpu_seconds > 0
    assert np.all(result.quality.contact_error_mm < 30)
    assert np.all(result.quality.limit_violation_rad < 1e-6)


def test_what_is_installed_is_found():
    assert installed_peers() == [name for name, (module, _) in PEERS.items() if find_spec(module)]


def test_a_track_goes_through_the_recorded_hands_and_keeps_the_bones():
    hands = held().hand_joints[:3].astype(float)
    track = moving_hand(hands, 8, 0.0, np.random.default_rng(0))
    assert track.shape == (16, 21, 3)
    np.testing.assert_allclose(bone_lengths(track), np.tile(bone_lengths(track[0]), (16, 1)), atol=1e-9)
    noisy = moving_hand(hands, 8, 0.002, np.random.default_rng(0))
    assert 0.0015 < np.std(noisy - track) < 0.0025


@pytest.mark.parametrize("name", list(FOLLOWERS))
def test_a_moving_hand_is_followed(name: str):
    if name in PEERS and name not in installed_peers():
        pytest.skip(f"{name} is not installed (extra 'bench')")
    hand = load_hand("allegro")
    track = moving_hand(held().hand_joints[:2].astype(float), 12, 0.0, np.random.default_rng(0))
    figures = measure(hand, FOLLOWERS[name](hand), track, track).figures()
    assert figures["fingertip_error_mm"] < 25
    if name == "fungrasp":
        assert figures["self_penetration_p95_mm"] < 1
