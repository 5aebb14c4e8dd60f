"""Where in the image a surface can't be: in front of what the camera measured, or below the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.perception.io.capture import Intrinsics

BEHIND = 0.01
"""A pixel shows something behind the object if it is deeper by this [m] than the object's nearest pixel."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """What the depth image and the table forbid to the object. ``free_space`` makes it."""

    intrinsics: Intrinsics
    depth: np.ndarray
    """Behind which a surface may be [m], shape [H, W]; 0: anywhere."""
    refuge: np.ndarray
    """Nearest pixel (row, column) that does not show something behind the object, shape [2, H, W]."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]`` with ``n . x + d`` the height above it [m], camera frame, shape [4]."""

    def intrusion(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points would have to move to be allowed, and where to.

        Args:
            points: [m], camera frame, shape [..., 3].

        Returns:
            distance [m], shape [...], 0 for allowed points; its gradient, shape [..., 3].
        """
        k = self.intrinsics
        z = np.maximum(points[..., 2], 1e-3)
        x, y = points[..., 0] / z, points[..., 1] / z
        u, v = k.fx * x + k.cx, k.fy * y + k.cy
        column, row = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
        seen = (column >= 0) & (column < k.width) & (row >= 0) & (row < k.height)
        column, row = np.where(seen, column, 0), np.where(seen, row, 0)
        short = np.where(seen, self.depth[row, column] - z, 0.0)
        away_v = row - self.refuge[0, row, column]
        away_u = column - self.refuge[1, row, column]
        pixels = np.hypot(away_u, away_v)
        sideways = pixels * z / k.fx
        aside = (pixels > 0) & (sideways < short)
        distance = np.where(aside, sideways, np.maximum(short, 0.0))
        unit = np.where(aside, 1.0 / np.maximum(pixels, 1.0), 0.0)
        du, dv = away_u * unit, away_v * unit
        gradient = np.stack([du, dv, np.where(aside, -(du * x + dv * y), -1.0)], axis=-1)
        if self.table is not None:
            below = -(points @ self.table[:3] + self.table[3])
            lower = below > distance
            distance = np.where(lower, below, distance)
            gradient = np.where(lower[..., None], -self.table[:3], gradient)
        return distance, gradient


def free_space(
    depth: np.ndarray,
    intrinsics: Intrinsics,
    shown: np.ndarray,
    table: np.ndarray | None = None,
    tolerance: float = 0.006,
) -> FreeSpace:
    """What a depth image forbids to an object.

    Args:
        depth: [m], shape [H, W]; 0: not measured.
        intrinsics: of the depth image.
        shown: which pixels show the object, bool, shape [H, W].
        table: its plane, see ``FreeSpace``.
        tolerance: how far a surface may be in front of the measurement, or below the table [m].
    """
    measured = depth > 0
    seen = shown & measured
    transformed: Any = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    level = depth[tuple(transformed)]
    open_space = measured & ~shown & (depth > level + BEHIND)
    refuge: Any = ndimage.distance_transform_edt(open_space, return_distances=False, return_indices=True)
    lowered = None if table is None else np.append(table[:3], table[3] + tolerance)
    return FreeSpace(intrinsics, np.where(measured, depth - tolerance, 0.0), refuge, lowered)
