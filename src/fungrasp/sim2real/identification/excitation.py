"""Commands that excite a hand's joints for identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.errors import FungraspError

KINDS = ("steps", "multi-sine")


@dataclass(frozen=True)
class Excitation:
    """How joints are excited.

    "steps": steps to random places, which show stiffness, friction and delay, then a chirp, for inertia
    and damping. "multi-sine": a sum of sines about the middle of where there is room, with small steps on it,
    all the time: so slow and so small that servos stay below their torque limits, which no fit counts.
    """

    kind: str = "steps"
    """"steps" or "multi-sine"."""

    seconds: float = 12.0
    """Duration [s]; the first half second rests."""
    rate: float = 50.0
    """Commands per second."""
    reach: float = 0.3
    """Farthest from the place of rest, as a share of each joint's range."""
    hold: float = 0.4
    """Of a step [s]."""
    fastest: float = 3.0
    """End of the chirp, and the fastest sine [Hz]."""
    slowest: float = 0.3
    """The slowest sine [Hz]."""
    sines: int = 4
    """Of each joint."""
    small_step: float = 0.02
    """Of the steps on the sines, as a share of each joint's range."""
    seed: int = 0
    """Decides the steps."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FungraspError(f"an excitation is {' or '.join(KINDS)}, not '{self.kind}'")
        if not 2 <= self.seconds <= 300 or not 5 <= self.rate <= 500 or not 0 < self.reach <= 0.5:
            raise FungraspError("an excitation takes 2 to 300 s, 5 to 500 Hz and a reach above 0 up to 0.5")


def excitation_commands(
    excitation: Excitation,
    rest: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    alike: np.ndarray | None = None,
) -> np.ndarray:
    """Goals of joints [rad], shape [T, U], within their limits; the first and the last are ``rest``.

    Args:
        excitation: kind of motion.
        rest: where the joints begin [rad], shape [U].
        lower: limits [rad], shape [U].
        upper: limits [rad], shape [U].
        alike: joints with the same number move alike in a multi-sine, shape [U]; none do if None.
    """
    e, rng = excitation, np.random.default_rng(excitation.seed)
    times = np.arange(round(e.seconds * e.rate)) / e.rate
    if e.kind == "multi-sine":
        groups = np.arange(len(rest)) if alike is None else alike
        return _multi_sine(e, rng, times, rest, lower, upper, groups)
    reach = e.reach * (upper - lower)
    blocks = np.maximum(times - REST, 0) // e.hold
    places = rng.uniform(-1, 1, (int(blocks[-1]) + 1, len(rest)))
    half = e.seconds / 2
    phase = rng.uniform(0, 2 * np.pi, len(rest))
    share = np.clip((times - half) / (e.seconds - half), 0, 1)[:, None]
    sweep = 0.5 * np.sin(2 * np.pi * e.fastest * (times - half)[:, None] * share / 2 + phase)
    offsets = np.where((times < half)[:, None], places[blocks.astype(int)], sweep)
    offsets[times < REST] = 0.0
    offsets[-1] = 0.0
    return np.clip(rest + reach * offsets, lower, upper)


def _multi_sine(
    e: Excitation,
    rng: np.random.Generator,
    times: np.ndarray,
    rest: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    groups: np.ndarray,
) -> np.ndarray:
    """Amplitudes fall with the root of the frequency: the same for inertia, damping and stiffness would take
    three excitations."""
    spread = np.exp(rng.uniform(-0.1, 0.1, (e.sines, groups.max() + 1)))
    frequency = np.geomspace(e.slowest, e.fastest, e.sines)[:, None] * spread
    phase = rng.uniform(0, 2 * np.pi, frequency.shape)
    angles = 2 * np.pi * frequency[:, None] * times[None, :, None] + phase[:, None]
    wave = np.sum(np.sqrt(frequency[:1] / frequency)[:, None] * np.sin(angles), axis=0)
    wave = (wave / np.abs(wave).max(axis=0))[:, groups]
    blocks = (np.maximum(times - REST, 0) // e.hold).astype(int)
    steps = rng.choice([-1.0, 1.0], (blocks[-1] + 1, groups.max() + 1))[blocks][:, groups]
    size = upper - lower
    room = (e.reach + e.small_step) * size
    middle = np.clip(rest, lower + room, upper - room)
    # A second to the middle and to full swing, and one back: no joint starts or ends with a jump.
    grown = np.clip(np.minimum(times - REST, times[-1] - times), 0.0, 1.0)[:, None]
    goals = rest + grown * (middle - rest + size * (e.reach * wave + e.small_step * steps))
    return np.clip(goals, lower, upper)


REST = 0.5
"""At the beginning [s]: identification starts at rest."""
