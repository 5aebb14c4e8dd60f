"""Exact distances and depths of hands near objects; the retargeter's grids are only approximate."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.signed_distance import nearest_on_mesh
from fungrasp.objects import ObjectModel

EXACT = 0.02
"""Parts of the hand nearer to the object's surface than this, outside or inside, are measured exactly [m]."""

GRID_ERROR = 0.001
"""A point whose distance by the grid is more than this is outside the object [m]."""


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
    link: np.ndarray,
) -> np.ndarray:
    """Depth of the deepest point of the hand in the object [m], shape [N]. In a thin wall, or at an edge, it
    is less than how far a ball reaches beyond the surface.

    Looks into the two balls of each link that reach farthest.

    Args:
        bank: of the objects' grids.
        link: which link each ball belongs to, shape [P].
        others: as for ``exact_clearance``.
    """
    rows, balls = _worst_balls(clearance, link)
    best = np.zeros((len(rows), 1, 3))
    distance = np.zeros((len(rows), 1))
    pick = np.arange(len(rows))
    for around in (_BALL, 0.25 * _BALL, 0.06 * _BALL):
        samples = best + around
        samples /= np.maximum(1.0, np.linalg.norm(samples, axis=-1, keepdims=True))
        places = centers[rows, balls][:, None] + radius[balls][:, None, None] * samples
        distance = _signed_distance(objects, bank, grid[rows], places)
        best = samples[pick, distance.argmin(axis=1)][:, None]
    depth = np.zeros(len(grid))
    np.maximum.at(depth, rows, -distance.min(axis=1, initial=0.0))
    return depth


def _worst_balls(clearance: np.ndarray, link: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and indices of balls that reach into the object: the two farthest of each link."""
    rows, balls = [], []
    for number in np.unique(link):
        members = np.flatnonzero(link == number)
        order = members[np.argsort(clearance[:, members], axis=1)[:, :2]]
        row, place = np.nonzero(np.take_along_axis(clearance, order, axis=1) < 0)
        rows.append(row)
        balls.append(order[row, place])
    return np.concatenate(rows), np.concatenate(balls)


def _signed_distance(
    objects: list[ObjectModel], bank: SignedDistanceBank, grid: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Exact distance of points that may be inside, by the side of the nearest triangle they are on; by
    the grid for the others. points: shape [M, S, 3]; returns shape [M, S]."""
    rough, _ = bank.query(grid, points)
    doubtful = rough < GRID_ERROR
    result = rough.copy()
    for number, thing in enumerate(objects):
        chosen = doubtful & (grid == number)[:, None]
        if chosen.any():
            nearest, face = nearest_on_mesh(thing.mesh, points[chosen])
            away = points[chosen] - nearest
            outside = np.sum(away * thing.mesh.face_normals[face], axis=1) > 0
            result[chosen] = np.where(outside, 1.0, -1.0) * np.linalg.norm(away, axis=1)
    return result


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


def _unit_ball(outer: int = 100, inner: int = 20) -> np.ndarray:
    """Points spread evenly over the unit sphere, over one of half the size, and the centre, shape [P, 3]."""
    shells = [np.zeros((1, 3))]
    for count, size in ((inner, 0.5), (outer, 1.0)):
        height = 1 - (2 * np.arange(count) + 1) / count
        turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        shells.append(size * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1))
    return np.concatenate(shells)


_BALL = _unit_ball()
