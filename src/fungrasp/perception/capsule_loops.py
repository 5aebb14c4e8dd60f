"""Distances of many points from capsules, in compiled loops.

Products are summed in the order in which NumPy's einsum does: x, z, y.
"""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part


@compiled_part
def _along(point, first, last):
    """Where on a line the point nearest to another is, 0 to 1, and the offset from there (x, y, z)."""
    lx, ly, lz = last[0] - first[0], last[1] - first[1], last[2] - first[2]
    x, y, z = point[0] - first[0], point[1] - first[1], point[2] - first[2]
    square = lx * lx + ly * ly + lz * lz
    part = (x * lx + z * lz + y * ly) / (square if square > 1e-12 else 1e-12)
    part = 0.0 if part < 0.0 else 1.0 if part > 1.0 else part
    return part, x - part * lx, y - part * ly, z - part * lz


@compiled
def line_distances(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray, distance: np.ndarray
) -> None:
    """Write the distance of each point, shape [P, 3], from the nearest of capsules, negative inside, shape
    [P]; infinite for points that are NaN.

    Args: first, last: ends of their lines, shape [C, 3]; radius: shape [C].
    """
    for p in range(len(points)):
        nearest = math.inf
        for c in range(len(first)):
            _, x, y, z = _along(points[p], first[c], last[c])
            apart = math.sqrt(x * x + y * y + z * z) - radius[c]
            nearest = apart if apart < nearest else nearest
        distance[p] = nearest


@compiled
def nearest_capsules(
    points: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    radius: np.ndarray,
    far_side: float,
    penalty: float,
    which: np.ndarray,
    distance: np.ndarray,
    along: np.ndarray,
    normal: np.ndarray,
) -> None:
    """Write what ``hand_capsules.nearest_capsules`` returns.

    Args: points: shape [P, 3]; first, last: shape [S, C, 3]; radius: at both ends, shape [C, 2]; far_side,
    penalty: ``FAR_SIDE`` and its penalty; which: int64, shape [S, P], as distance and along; normal: shape
    [S, P, 3].
    """
    for p in range(len(points)):
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        length = math.sqrt(px * px + py * py + pz * pz)
        px, py, pz = px / length, py / length, pz / length
        for s in range(len(first)):
            which[s, p], distance[s, p], along[s, p] = 0, math.nan, math.nan
            normal[s, p, 0] = normal[s, p, 1] = normal[s, p, 2] = math.nan
            least = math.inf
            for c in range(first.shape[1]):
                part, x, y, z = _along(points[p], first[s, c], last[s, c])
                length = math.sqrt(x * x + z * z + y * y)
                divisor = length if length > 1e-9 else 1e-9
                x, y, z = x / divisor, y / divisor, z / divisor
                apart = length - (radius[c, 0] + part * (radius[c, 1] - radius[c, 0]))
                if x * px + z * pz + y * py > far_side:
                    apart += penalty
                if abs(apart) < least:
                    least = abs(apart)
                    which[s, p], distance[s, p], along[s, p] = c, apart, part
                    normal[s, p, 0], normal[s, p, 1], normal[s, p, 2] = x, y, z
