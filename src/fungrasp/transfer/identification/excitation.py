"""Commands that excite a hand's joints for identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.errors import FungraspError


@dataclass(frozen=True)
class Excitation:
    """Steps to random places, which show stiffness, friction and delay, then a chirp, which shows inertia and
    damping."""

    seconds: float = 12.0
    """Duration [s]; the first half second rests."""
    rate: float = 50.0
    """Commands per second."""
    reach: float = 0.3
    """Farthest from the place of rest, as a share of each joint's range."""
    hold: float = 0.4
    """Of a step [s]."""
    fastest: float = 3.0
    """End of the chirp [Hz]."""
    seed: int = 0
    """Decides the steps."""

    def __post_init__(self) -> None:
        if not 2 <= self.seconds <= 300 or not 5 <= self.rate <= 500 or not 0 < self.reach <= 0.5:
            raise FungraspError("an excitation takes 2 to 300 s, 5 to 500 Hz and a reach above 0 up to 0.5")


def excitation_commands(
    excitation: Excitation, rest: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Goals of joints [rad], shape [T, U], within their limits; the first and the last are ``rest``.

    Args:
        excitation: kind of motion.
        rest: where the joints begin [rad], shape [U].
        lower: limits [rad], shape [U].
        upper: limits [rad], shape [U].
    """
    e, rng = excitation, np.random.default_rng(excitation.seed)
    times = np.arange(round(e.seconds * e.rate)) / e.rate
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


REST = 0.5
"""At the beginning [s]: identification starts at rest."""
