"""Exact distances and depths of hands near objects; the retargeter's grids are only approximate."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.signed_distance import nearest_on_mesh
from fungrasp.objects import ObjectModel

EXACT = 0.02
"""Parts of the hand nearer to the object's surface than this, outside or inside, are measured exactly [m]."""


def exact_clearance(
    objects: list[ObjectModel],
    grid: np.ndarray,
    centers: np.ndarray,
    clearance: np.ndarray,
    radius: np.ndarray,
) -> np.ndarray:
    """The clearance, of balls near the object by the exact distance from its triangles: away from the surface
    the grid is up to a millimetre off.

    Args:
        objects: O of them.
        grid: index of the object of each grasp, shape [N].
        centers: of the balls, object frame [m], shape [N, P, 3].
        clearance: by the grid [m], shape [N, P].
        radius: of the balls [m], shape [P].
    """
    near = np.abs(clearance) < EXACT
    nearest = nearest_points(objects, grid, centers, near)
    inside = clearance + radius < 0
    distance = np.where(inside, -1.0, 1.0) * np.linalg.norm(centers - nearest, axis=-1)
    return np.where(near, distance - radius, clearance)


def deepest(
    objects: list[ObjectModel],
    bank: SignedDistanceBank,
    grid: np.ndarray,
    centers: np.ndarray,
    clearance: np.ndarray,
    radius: np.ndarray,
    chunk: int = 4096,
) -> np.ndarray:
    """Depth of the deepest point of the balls in the object [m], shape [N]. In a thin wall, or at an edge, it
    is less than how far the ball reaches beyond the surface.

    Args: as for ``exact_clearance``.
    """
    depth = np.zeros(len(grid))
    rows, balls = np.nonzero(clearance < 0)
    for start in range(0, len(rows), chunk):
        row, ball = rows[start : start + chunk], balls[start : start + chunk]
        best = np.zeros((len(row), 1, 3))
        for around in (_BALL, 0.2 * _BALL, 0.05 * _BALL):
            samples = best + around
            samples /= np.maximum(1.0, np.linalg.norm(samples, axis=-1, keepdims=True))
            places = centers[row, ball][:, None] + radius[ball][:, None, None] * samples
            distance, _ = bank.query(grid[row], places)
            best = np.take_along_axis(samples, distance.argmin(axis=1)[:, None, None], axis=1)
        lowest = centers[row, ball][:, None] + radius[ball][:, None, None] * best
        inside = (distance.min(axis=1) < 0)[:, None]
        surface = nearest_points(objects, grid[row], lowest, inside)
        np.maximum.at(depth, row, np.linalg.norm(lowest - surface, axis=-1)[:, 0])
    return depth


def nearest_points(
    objects: list[ObjectModel], grid: np.ndarray, points: np.ndarray, which: np.ndarray
) -> np.ndarray:
    """Points of the objects' surfaces that are nearest to some points, the points themselves for the others.

    Args:
        objects: O of them.
        grid: index of the object of each grasp, shape [N].
        points: object frame [m], shape [N, P, 3].
        which: shape [N, P] bool.
    """
    result = points.copy()
    for number, thing in enumerate(objects):
        chosen = which & (grid == number)[:, None]
        if chosen.any():
            result[chosen] = nearest_on_mesh(thing.mesh, points[chosen])[0]
    return result


def _unit_ball(outer: int = 120, inner: int = 40) -> np.ndarray:
    """Points spread evenly over the unit sphere, over one of half the size, and the centre, shape [P, 3]."""
    shells = [np.zeros((1, 3))]
    for count, size in ((inner, 0.5), (outer, 1.0)):
        height = 1 - (2 * np.arange(count) + 1) / count
        turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        shells.append(size * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1))
    return np.concatenate(shells)


_BALL = _unit_ball()
