"""Excitation of a hand's joints for identification: sums of sines, one finger after the other.

Frequencies are multiples of the slowest one, logarithmically spaced up to the fastest, and distributed among
the joints of a finger so that no two joints share one. Amplitudes are inversely proportional to frequency, so
that all sines have the same speed, which is the limiting factor. Schroeder phases keep the peak of the sum
low: ``phase_k = -2 pi sum_{i<k} (k - i) power_i`` (M. R. Schroeder, Synthesis of low-peak-factor signals and
binary sequences with low autocorrelation, IEEE Trans. Inf. Theory 16, 1970).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.sim2real.identification.log_simulation import chain_of, simulate_log
from fungrasp.sim2real.identification.motion_log import MotionLog, joint_samples
from fungrasp.sim2real.joint_dynamics import model_dynamics

REST = 0.5
"""Rest before and after each finger's motion [s]."""

RAMP = 1.0
"""Duration of the ramp from rest to full amplitude and of the ramp back [s]."""

LINES = 8
"""Approximate number of sines per joint; more sines have smaller amplitudes."""

SMALLEST_SHARE = 0.2
"""Smallest useful share of an amplitude; excitation fails if avoiding self-contact requires less."""

SIZINGS = 3
"""Number of simulations that reduce amplitudes to the torque limits."""

CHECKED_EVERY = 2
"""Every how many commands the posture is checked for contacts."""


@dataclass(frozen=True)
class Excitation:
    """Settings of the excitation: one finger at a time, from rest to rest, while the others hold.

    Amplitudes are the largest within the limits of reach, speed and, in ``safe_motion``, torque.
    """

    seconds: float = 8.0
    """Duration per finger [s], including rest before and after."""
    rate: float = 100.0
    """Commands per second."""
    reach: float = 0.15
    """Largest distance from the middle of the motion, as a share of each joint's range."""
    slowest: float = 0.2
    """Lowest frequency, and distance between two frequencies [Hz]."""
    fastest: float = 8.0
    """Highest frequency [Hz]; lower values separate delay and inertia less well."""
    speed: float = 0.5
    """Largest speed of a command, as a share of the driver's limit."""
    torque: float = 0.5
    """Largest torque of a servo according to the hand's model, as a share of its limit."""
    seed: int = 0
    """Random seed of the phases."""

    def __post_init__(self) -> None:
        if not 2 * (REST + RAMP) < self.seconds <= 300 or not 5 <= self.rate <= 500:
            raise FungraspError(
                "an excitation takes more than 3 s and at most 300 s for each finger, and 5 to 500 Hz"
            )
        if not 0 < self.reach <= 0.5 or not 0 < self.speed <= 1 or not 0 < self.torque <= 1:
            raise FungraspError("an excitation takes a reach above 0 up to 0.5, and shares above 0 up to 1")
        if not 0 < self.slowest <= self.fastest <= self.rate / 5:
            raise FungraspError("the sines of an excitation are above 0 Hz, up to a fifth of its rate")


class ExcitationLimits(NamedTuple):
    """Limits of U joints."""

    lower: np.ndarray
    """Lower position limits [rad], shape [U]."""
    upper: np.ndarray
    """Upper position limits [rad], shape [U]."""
    speed: np.ndarray | float = np.inf
    """Speed limits of the driver's setpoints [rad/s], shape [U]."""
    torque: np.ndarray | float = np.inf
    """Torque limits that the driver sets [N m], shape [U]; infinite if it sets none."""


@dataclass(frozen=True, eq=False)
class ExcitationMotion:
    """Commands of an excitation."""

    commands: np.ndarray
    """Goals [rad], shape [T, U]."""
    moving: np.ndarray
    """Whether each joint is excited, shape [T, U] bool; other joints stay at rest."""


def excitation_motion(
    excitation: Excitation,
    rest: np.ndarray,
    room: ExcitationLimits,
    finger: np.ndarray,
    share: np.ndarray | None = None,
) -> ExcitationMotion:
    """Return commands within the joints' limits that begin and end at ``rest``.

    Args:
        rest: initial positions [rad], shape [U].
        finger: finger number of each joint, shape [U].
        share: factor on the amplitude of each joint, shape [U]; 1 if None.
    """
    e, rng = excitation, np.random.default_rng(excitation.seed)
    lower, upper, speed = room.lower, room.upper, np.broadcast_to(room.speed, rest.shape)
    times = np.arange(round(e.seconds * e.rate)) / e.rate
    share = np.ones(len(rest)) if share is None else share
    swing = np.clip(np.minimum(times - REST, times[-1] - REST - times) / RAMP, 0.0, 1.0)
    swing = 0.5 - 0.5 * np.cos(np.pi * swing)
    numbers = np.unique(finger)
    commands = np.tile(rest, (len(numbers) * len(times), 1))
    moving = np.zeros(commands.shape, dtype=bool)
    for turn, number in enumerate(numbers):
        rows, joints = slice(turn * len(times), (turn + 1) * len(times)), np.flatnonzero(finger == number)
        for place, joint in enumerate(joints):
            wave = _wave(e, times, place, len(joints), rng.uniform())
            reach = min(e.reach * share[joint], 0.5) * (upper[joint] - lower[joint])
            middle = np.clip(rest[joint], lower[joint] + reach, upper[joint] - reach)
            offsets = swing * (middle - rest[joint] + reach * wave)
            fastest = np.abs(np.diff(offsets)).max() * e.rate
            offsets *= min(1.0, e.speed * speed[joint] / max(fastest, 1e-9))
            commands[rows, joint] += offsets
        moving[rows, joints] = True
    return ExcitationMotion(np.clip(commands, lower, upper), moving)


def _wave(e: Excitation, times: np.ndarray, place: int, joints: int, begin: float) -> np.ndarray:
    """Return the sum of sines of one joint of a finger, peak 1, shape [T]. begin: share of the period."""
    last = int(e.fastest / e.slowest + 1e-6)
    chosen = np.unique(np.rint(np.geomspace(1, last, LINES * joints)).astype(int))
    # Distribute frequencies back and forth, so that every joint has slow and fast ones.
    dealt = np.arange(len(chosen)) % (2 * joints)
    dealt = np.minimum(dealt, 2 * joints - 1 - dealt)
    own = chosen[dealt == place] if (dealt == place).any() else chosen
    multiples, power = np.arange(1, last + 1), np.zeros(last)
    power[own - 1] = 1.0 / own**2
    power /= power.sum()
    phase = -2 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(power))[:-1]])
    angles = 2 * np.pi * multiples * (e.slowest * times[:, None] + begin) + phase
    wave = np.sin(angles) @ np.sqrt(power)
    return wave / np.abs(wave).max()


def safe_motion(
    excitation: Excitation,
    hand: Hand,
    rest: np.ndarray,
    room: ExcitationLimits,
    gravity: np.ndarray,
) -> ExcitationMotion:
    """Return the excitation of a hand's independent joints, with amplitudes small enough to avoid
    self-contact and to respect torque limits.

    Args:
        rest: current positions [rad], shape [U].
        gravity: in the palm frame [m/s^2], shape [3].

    Raises:
        FungraspError: every useful motion from these positions has self-contact.
    """
    joints = tuple(hand.actuators)
    finger = chain_of(hand, joints)
    servos = list(hand.actuators.values())
    most = excitation.torque * np.minimum(room.torque, [servo.force_limit for servo in servos])
    share = np.ones(len(joints))

    def motion() -> ExcitationMotion:
        return excitation_motion(excitation, rest, room, finger, share)

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
    """Return the largest servo torques according to the hand's model [N m], shape [U]."""
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
