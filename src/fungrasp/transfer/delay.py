"""Signals that arrive late, in each world by its own number of steps."""

from __future__ import annotations

import numpy as np

from fungrasp.errors import FungraspError


def delay_steps(delay: np.ndarray, period: float) -> np.ndarray:
    """Delays as the nearest whole numbers of steps, shape [W] int.

    Args:
        delay: [s], shape [W].
        period: of a step [s].
    """
    return np.rint(np.asarray(delay) / period).astype(int)


class Delay:
    """A signal of W worlds, delayed. A world that has pushed fewer values than its delay since it was reset
    gets the value it was reset to."""

    def __init__(self, initial: np.ndarray, longest: int):
        """
        Args:
            initial: value of the signal before the first push, shape [W, ...]; not delayed until ``reset``
                says so.
            longest: delay that can be asked for, in steps.

        Raises:
            FungraspError: ``longest`` is negative.
        """
        if longest < 0:
            raise FungraspError(f"a delay can't be negative: {longest} steps")
        initial = np.asarray(initial)
        self._ring = np.repeat(initial[None], longest + 1, axis=0)
        self._steps = np.zeros(len(initial), dtype=int)
        self._newest = 0

    def reset(self, ids: np.ndarray, value: np.ndarray, steps: np.ndarray) -> None:
        """Begin anew in some worlds.

        Args:
            ids: worlds, shape [I].
            value: of the signal until now, shape [I, ...].
            steps: delay, shape [I] int.

        Raises:
            FungraspError: a delay is negative or longer than the longest.
        """
        steps = np.asarray(steps)
        if ((steps < 0) | (steps >= len(self._ring))).any():
            raise FungraspError(
                f"delays must be 0 to {len(self._ring) - 1} steps, not {steps.min()} to {steps.max()}"
            )
        self._ring[:, ids] = value
        self._steps[ids] = steps

    def push(self, value: np.ndarray) -> np.ndarray:
        """Take the signal's new value [W, ...], return the delayed one [W, ...]."""
        self._newest = (self._newest + 1) % len(self._ring)
        self._ring[self._newest] = value
        worlds = np.arange(len(self._steps))
        return self._ring[(self._newest - self._steps) % len(self._ring), worlds]
