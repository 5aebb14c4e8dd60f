"""The history of observations that a student's encoder gets."""

from __future__ import annotations

import numpy as np

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

    def __init__(self, worlds: int, size: int):
        """size: H, numbers of a control step."""
        self.window = np.zeros((worlds, HISTORY, size), dtype=np.float32)

    def push(self, seen: np.ndarray, begun: np.ndarray) -> np.ndarray:
        """The windows with one more control step, shape [W, HISTORY, H].

        Args:
            seen: what the encoder gets of it, shape [W, H].
            begun: worlds whose episode is new.
        """
        self.window[begun] = 0.0
        self.window = np.concatenate([self.window[:, 1:], seen[:, None]], axis=1)
        return self.window
