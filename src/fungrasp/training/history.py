"""The history of observations that a student's encoder gets."""

from __future__ import annotations

import numpy as np

HISTORY = 10
"""Control steps that the encoder looks back on, the present one included."""

HISTORY_PARTS = (
    "joints",
    "servo_errors",
    "joint_changes",
    "palm_error",
    "target_contacts",
    "last_action",
    "surface_distances",
)
"""Parts of the robot's observation that the encoder sees."""

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

    def __init__(self, worlds: int, layout: Layout):
        self._columns = columns(layout, HISTORY_PARTS)
        self.window = np.zeros((worlds, HISTORY, len(self._columns)), dtype=np.float32)

    def push(self, observation: np.ndarray, begun: np.ndarray) -> np.ndarray:
        """The windows with one more observation, shape [W, HISTORY, H]. begun: worlds whose episode is
        new."""
        self.window[begun] = 0.0
        self.window = np.concatenate([self.window[:, 1:], observation[:, None, self._columns]], axis=1)
        return self.window
