"""Commands that excite a hand's joints for identification: a sum of sines, one finger after the other.

Lines of one period: multiples of the slowest frequency up to the fastest, evenly spread on a logarithmic
scale, dealt in turn to the joints of a finger, so that no two of them share one. Amplitudes fall with the
frequency: every line moves at the same speed, which is what limits them. Phases are Schroeder's, which keep
the peak of a sum of sines low:
``phase_k = -2 pi sum_{i<k} (k - i) power_i`` (M. R. Schroeder, Synthesis of low-peak-factor signals and
binary sequences with low autocorrelation, IEEE Trans. Inf. Theory 16, 1970).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError

REST = 0.5
"""Before and after each finger's motion [s]: it begins and ends at rest."""

RAMP = 1.0
"""From rest to full swing, and back [s]."""


LINES = 8
"""Of each joint, about; more of them leave less amplitude for each."""


@dataclass(frozen=True)
class Excitation:
    """How joints are excited: one finger at a time while the others hold, from rest to rest.

    The amplitude of a joint is the largest that keeps its reach, the speed and, where ``safe_motion`` makes
    the motion, the torque.
    """

    seconds: float = 8.0
    """Of each finger [s], rest before and after included."""
    rate: float = 100.0
    """Commands per second."""
    reach: float = 0.15
    """Farthest from the middle of the motion, as a share of each joint's range."""
    slowest: float = 0.2
    """The slowest sine, and the distance of two lines [Hz]."""
    fastest: float = 8.0
    """The fastest sine [Hz]: what is slower tells delay from inertia half as well."""
    speed: float = 0.5
    """Largest speed of a command, as a share of the driver's limit."""
    torque: float = 0.5
    """Largest torque that a servo may need by the hand's model, as a share of its limit."""
    seed: int = 0
    """Decides by how much the lines of the joints begin later."""

    def __post_init__(self) -> None:
        if not 2 * (REST + RAMP) < self.seconds <= 300 or not 5 <= self.rate <= 500:
            raise FungraspError(
                "an excitation takes more than 3 s and at most 300 s for each finger, and 5 to 500 Hz"
            )
        if not 0 < self.reach <= 0.5 or not 0 < self.speed <= 1 or not 0 < self.torque <= 1:
            raise FungraspError("an excitation takes a reach above 0 up to 0.5, and shares above 0 up to 1")
        if not 0 < self.slowest <= self.fastest <= self.rate / 5:
            raise FungraspError("the sines of an excitation are above 0 Hz, up to a fifth of its rate")


@dataclass(frozen=True, eq=False)
class ExcitationMotion:
    """Commands of an excitation."""

    commands: np.ndarray
    """Goals [rad], shape [T, U]."""
    moving: np.ndarray
    """Which joints are excited at each, shape [T, U]; the others stay at rest."""


def excitation_motion(
    excitation: Excitation,
    rest: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    speed: np.ndarray,
    finger: np.ndarray,
    share: np.ndarray | None = None,
) -> ExcitationMotion:
    """Commands of joints within their limits; the first and the last are ``rest``.

    Args:
        excitation: kind of motion.
        rest: where the joints begin [rad], shape [U].
        lower: limits [rad], shape [U].
        upper: limits [rad], shape [U].
        speed: of the driver's setpoints at most [rad/s], shape [U].
        finger: number of the finger that each joint belongs to, shape [U].
        share: of the amplitude that is left of each joint's, shape [U]; all if None.
    """
    e, rng = excitation, np.random.default_rng(excitation.seed)
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
    """The lines of one of a finger's joints, largest value 1, shape [T]. begin: of the period, 0 to 1."""
    last = int(e.fastest / e.slowest + 1e-6)
    chosen = np.unique(np.rint(np.geomspace(1, last, LINES * joints)).astype(int))
    # Dealt to and fro, so that every joint has slow ones and fast ones.
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
