"""Torques that carry the hand's weight."""

import time

import mujoco
import numpy as np
import pytest

from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.hands import load_hand
from fungrasp.sim2real.gravity_compensation import GravityCompensation, setpoint_offset

SIDEWAYS = quaternion_from_rotation_vector(np.array([np.pi / 2, 0.0, 0.0]))


@pytest.mark.parametrize("name", ["allegro", "inspire", "leap"])
def test_agrees_with_inverse_dynamics(name: str) -> None:
    """On a hand held in the world, mj_inverse of rest gives the same torques."""
    hand, rng = load_hand(name), np.random.default_rng(0)
    spec = hand.spec()
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    spec.option.gravity = [0, 0, -9.81]
    matrix, _ = hand.coupling
    rotation = quaternion_from_rotation_vector(rng.normal(size=3))
    # Turn the whole hand, that the palm is at the origin of, in a world with gravity.
    body = mujoco.MjSpec()
    body.option.gravity, body.option.disableflags = [0, 0, -9.81], spec.option.disableflags
    frame = body.worldbody.add_body(name="mount", quat=rotation).add_frame()
    body.attach(spec, frame=frame, prefix="h/")
    model = body.compile()
    data = mujoco.MjData(model)
    limits = hand.joint_limits
    joints = hand.independent(rng.uniform(*np.clip(limits, -1.5, 1.5).T))
    for joint, value in zip(hand.joint_names, hand.all_joints(joints), strict=True):
        data.qpos[model.joint("h/" + joint).qposadr[0]] = value
    mujoco.mj_inverse(model, data)
    dofs = [model.joint("h/" + joint).dofadr[0] for joint in hand.joint_names]
    palm = model.body("h/" + hand.palm).id
    expected = matrix.T @ data.qfrc_inverse[dofs]
    torques = GravityCompensation(hand).torques(data.xquat[palm], joints)
    np.testing.assert_allclose(torques, expected, atol=1e-9)
    assert np.abs(torques).max() > 1e-3


def test_a_hand_hanging_sideways_does_not_sag() -> None:
    """With the torques a weak servo keeps its target; without them it sags."""
    hand = load_hand("allegro")
    sag = {}
    for compensate in (False, True):
        spec = hand.spec()
        world = mujoco.MjSpec()
        frame = world.worldbody.add_body(quat=SIDEWAYS).add_frame()
        world.attach(spec, frame=frame, prefix="")
        model = world.compile()
        data = mujoco.MjData(model)
        gravity = GravityCompensation(hand)
        palm = model.body(hand.palm).id
        joints = np.clip(np.full(16, 0.3), *hand.joint_limits.T)
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        for _ in range(500):
            torques = gravity.torques(data.xquat[palm], data.qpos) if compensate else np.zeros(16)
            data.ctrl[:] = joints + setpoint_offset(torques, np.full(16, 4.0))
            mujoco.mj_step(model, data)
        sag[compensate] = np.abs(data.qpos - joints).max()
    assert sag[False] > 0.01
    assert sag[True] < 1e-4


def test_a_tick_is_cheap() -> None:
    gravity, joints = GravityCompensation(load_hand("allegro")), np.zeros(16)
    fastest = np.inf
    for _ in range(50):
        start = time.perf_counter()
        for _ in range(20):
            gravity.torques(SIDEWAYS, joints)
        fastest = min(fastest, (time.perf_counter() - start) / 20)
    # 6 us on a quiet machine.
    assert fastest < 40e-6
