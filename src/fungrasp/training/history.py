"""The history of observations that a student's encoder gets."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.arrays import moved_to
from fungrasp.geometry.poses import Array, array_namespace

HISTORY = 10
"""Control steps that the encoder looks back on, the present one included."""

Layout = tuple[tuple[str, int], ...]


def columns(layout: Layout, names: tuple[str, ...]) -> np.ndarray:
    """Where some parts lie in a flat observation."""
    starts = dict(
        zip([name for name, _ in layout], np.cumsum([0, *(n for _, n in layout)])[:-1], strict=True)
    )
    sizes = dict(layout)
    return np.concatenate([starts[name] + np.arange(sizes[name]) for name in names])


class History:
    """The last observations of W worlds, zeros before an episode's first."""

    def __init__(self, worlds: int, size: int, on: Array):
        """
        Args:
            worlds: W.
            size: H, numbers of a control step.
            on: an array of the library and the device of what is seen.
        """
        xp = array_namespace(on)
        self.window = xp.zeros((worlds, HISTORY, size), dtype=xp.float32, device=on.device)

    def push(self, seen: Array, begun: np.ndarray) -> Array:
        """The windows with one more control step, shape [W, HISTORY, H].

        Args:
            seen: what the encoder gets of it, shape [W, H].
            begun: worlds whose episode is new.
        """
        self.window[moved_to(self.window, begun)] = 0.0
        self.window = array_namespace(seen).concat([self.window[:, 1:], seen[:, None]], axis=1)
        return self.window
