"""An excitation that a hand can make: it doesn't touch itself, and no servo needs all its torque."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.sim2real.identification.excitation import Excitation, ExcitationMotion, excitation_motion
from fungrasp.sim2real.identification.finger_chains import chain_of
from fungrasp.sim2real.identification.joint_samples import joint_samples
from fungrasp.sim2real.identification.log_simulation import simulate_log
from fungrasp.sim2real.identification.motion_log import MotionLog
from fungrasp.sim2real.joint_dynamics import model_dynamics

SMALLEST_SHARE = 0.2
"""A motion that must be made smaller than this share of itself so that the hand doesn't touch itself shows
nothing."""

SIZINGS = 3
"""Simulations in which amplitudes are made smaller until no servo needs more torque than it may."""

CHECKED_EVERY = 2
"""Commands between two postures that are checked for contacts."""


def safe_motion(
    excitation: Excitation,
    hand: Hand,
    rest: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    speed: np.ndarray,
    torque: np.ndarray,
    gravity: np.ndarray,
) -> ExcitationMotion:
    """The excitation of a hand's independent joints from where it is, with amplitudes that are small enough.

    Args:
        excitation: kind of motion.
        hand: its model.
        rest: where it is [rad], shape [U].
        lower: limits [rad], shape [U].
        upper: limits [rad], shape [U].
        speed: of the driver's setpoints at most [rad/s], shape [U].
        torque: that the driver asks for at most [N m], shape [U]; infinite where it leaves that to the hand.
        gravity: in the palm's frame [m/s^2], shape [3].

    Raises:
        FungraspError: the hand touches itself in every motion from this place.
    """
    joints = tuple(hand.actuators)
    finger = chain_of(hand, joints)
    servos = list(hand.actuators.values())
    most = excitation.torque * np.minimum(torque, [servo.force_limit for servo in servos])
    share = np.ones(len(joints))

    def motion() -> ExcitationMotion:
        return excitation_motion(excitation, rest, lower, upper, speed, finger, share)

    for _ in range(SIZINGS):
        share *= np.minimum(1.0, most / np.maximum(_torques(hand, motion(), excitation.rate, gravity), 1e-9))
    data = mujoco.MjData(hand.model)
    before = _contacts(hand.model, data, hand.all_joints(rest))
    for number in np.unique(finger):
        own, least = finger == number, SMALLEST_SHARE * share.copy()
        while True:
            made = motion()
            rows = np.flatnonzero(made.moving[:, own].any(axis=1))[::CHECKED_EVERY]
            postures = hand.all_joints(made.commands[rows])
            if all(_contacts(hand.model, data, posture) <= before for posture in postures):
                break
            share[own] *= 0.85
            if (share < least).any():
                name = joints[int(np.flatnonzero(own)[0])]
                raise FungraspError(
                    f"hand '{hand.name}' touches itself wherever the finger of '{name}' moves from this "
                    "place: put it into a half open posture first"
                )
    return motion()


def _torques(hand: Hand, motion: ExcitationMotion, rate: float, gravity: np.ndarray) -> np.ndarray:
    """Largest torques of the servos by the hand's model [N m], shape [U]."""
    times = np.arange(len(motion.commands)) / rate
    dynamics = model_dynamics(hand)
    log = MotionLog(dynamics.joints, times, motion.commands, motion.commands, gravity, moving=motion.moving)
    samples = joint_samples(log)
    positions = simulate_log(hand, samples, [dynamics])[0]
    servos = hand.actuators.values()
    kp, kd = np.array([s.kp for s in servos]), np.array([s.kd for s in servos])
    torques = kp * (samples.commands - positions) - kd * np.gradient(positions, 1.0 / rate, axis=0)
    return np.abs(torques).max(axis=0)


def _contacts(model: mujoco.MjModel, data: mujoco.MjData, joints: np.ndarray) -> set[tuple[int, int]]:
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    return {(int(c.geom1), int(c.geom2)) for c in data.contact if c.dist < 0.0}
