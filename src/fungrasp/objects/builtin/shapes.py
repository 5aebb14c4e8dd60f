"""Convex solids, as the points they are the hull of: [m], shape [N, 3], object frame.

Neighbouring solids of a row (``ring``, ``sweep``) share their corner points exactly, so that their union has no seams.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Solid = np.ndarray
"""Points [m], shape [N, 3]: the solid is their convex hull."""


def box(size: Sequence[float], center: Sequence[float] = (0, 0, 0)) -> Solid:
    """A box of ``size`` [m] around ``center`` [m]."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return corners * np.asarray(size) / 2 + np.asarray(center)


def lathe(profile: Sequence[tuple[float, float]], segments: int = 40) -> Solid:
    """A convex solid of revolution about z. profile: (radius, height) [m] from bottom to top."""
    return np.concatenate([_circle(radius, height, segments) for radius, height in profile])


def ring(
    outer: Sequence[tuple[float, float]], inner: Sequence[tuple[float, float]], pieces: int = 12, fineness: int = 4
) -> list[Solid]:
    """A hollow solid of revolution about z, cut into ``pieces`` equal sectors.

    Args:
        outer: convex profile of (radius, height) [m].
        inner: profile of the hole; between sectors' edges it is straight, so it is a polygon with ``pieces`` sides.
        pieces: number of sectors.
        fineness: edges of the outer circle per sector.
    """
    angles = np.linspace(0, 2 * np.pi, pieces * fineness, endpoint=False)
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    solids = []
    for k in range(pieces):
        arc = corners[np.arange(k * fineness, (k + 1) * fineness + 1) % len(corners)]
        points = [_at(arc, radius, height) for radius, height in outer]
        points += [_at(arc[[0, -1]], radius, height) for radius, height in inner]
        solids.append(np.concatenate(points))
    return solids


def sweep(sections: Sequence[np.ndarray]) -> list[Solid]:
    """A bar through convex ``sections``, each [m], shape [S, 3]: one solid between each two neighbours."""
    return [np.concatenate(pair) for pair in zip(sections[:-1], sections[1:], strict=True)]


def _circle(radius: float, height: float, segments: int) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    return _at(np.stack([np.cos(angles), np.sin(angles)], axis=1), radius, height)


def _at(directions: np.ndarray, radius: float, height: float) -> np.ndarray:
    return np.column_stack([radius * directions, np.full(len(directions), height)])
