"""Other packages on the same grasps: the hand they read is ours, and what they give is judged alike."""

from __future__ import annotations

from importlib.util import find_spec

import mujoco
import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from benchmarks.peers.comparison import PEERS, compare_method, installed_peers
from benchmarks.peers.position_solvers import hand_urdf
from benchmarks.peers.problem import PeerProblem
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
