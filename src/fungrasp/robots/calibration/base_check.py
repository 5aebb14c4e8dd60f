"""Whether an arm stands where its cell says: by points that its flange has touched."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.formats.guarded import guarded

LARGEST_MISS = 0.005
"""A flange that is farther from a touched point than this means another base [m]."""

LEAST_POINTS = 3
"""Two tell the turn; a third tells a slip."""

LEAST_SPREAD = 0.1
"""Points nearer to their middle than this say little of the turn [m]."""


@dataclass(frozen=True, eq=False)
class BaseCheck:
    """How far the flange is from where points were touched."""

    miss: float
    """Farthest [m]."""
    offset: np.ndarray
    """From where the cell has the points to where they are, at their middle, world frame [m], shape [3]."""
    turn: float
    """By which the base is turned about the vertical from what the cell says [rad]."""
    count: int
    """Number of points."""

    @property
    def fault(self) -> str:
        """What is wrong, as a phrase; "" for nothing."""
        if self.miss <= LARGEST_MISS:
            return ""
        x, y, z = 1e3 * self.offset
        degrees = round(np.rad2deg(self.turn))
        said = (
            f"the touched points are up to {1e3 * self.miss:.0f} mm from where 'arm.pose_world_base' has "
            f"them: turned by {degrees} degrees about z, and off by ({x:.0f}, {y:.0f}, {z:.0f}) mm at their "
            "middle"
        )
        if abs(abs(degrees) - 180) < 5:
            said += "; the pendant's Base is turned by 180 degrees from ours"
        return said


def check_base(computed: np.ndarray, touched: np.ndarray) -> BaseCheck:
    """Compare where the flange is by the cell with where it was.

    Args:
        computed: by forward kinematics, world frame [m], shape [K, 3].
        touched: the marked points, world frame [m], shape [K, 3].

    Raises:
        FungraspError: too few points, or too near to one another.
    """
    if computed.shape != touched.shape or touched.ndim != 2 or len(touched) < LEAST_POINTS:
        raise FungraspError(
            f"the base is checked with {LEAST_POINTS} touched points or more, of 3 numbers each"
        )
    a, b = (points - points.mean(axis=0) for points in (computed, touched))
    if np.linalg.norm(b[:, :2], axis=1).max() < LEAST_SPREAD:
        raise FungraspError("the touched points are too near to one another: 30 cm apart and more")
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    turn = float(np.arctan2(sine, np.sum(a[:, :2] * b[:, :2])))
    miss = float(np.linalg.norm(touched - computed, axis=1).max())
    return BaseCheck(miss, touched.mean(axis=0) - computed.mean(axis=0), turn, len(touched))


@guarded("touched points")
def load_touched(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Postures of the arm [rad], shape [K, M], and where its flange touched points, world frame [m], shape
    [K, 3]. path: JSON file with ``joints`` and ``flange``.

    Raises:
        FungraspError: the file is none of these.
    """
    tree = json.loads(Path(path).read_text(encoding="utf-8"))
    try:
        joints, flange = (np.array(tree[name], dtype=float) for name in ("joints", "flange"))
    except (KeyError, TypeError, ValueError) as error:
        raise FungraspError(f"{path}: needs 'joints' and 'flange', lists of lists of numbers") from error
    finite = np.isfinite(joints).all() and np.isfinite(flange).all()
    if joints.ndim != 2 or flange.shape != (len(joints), 3) or not finite:
        raise FungraspError(f"{path}: as many postures as points of 3 numbers are needed")
    return joints, flange
