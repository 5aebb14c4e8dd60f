"""Exact distances of hands from objects and depths in them; the signed-distance grids are approximate."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.signed_distance import nearest_on_mesh
from fungrasp.objects import ObjectModel

EXACT_WITHIN = 0.02
"""Spheres nearer to the object's surface than this, outside or inside, are measured exactly [m]."""

GRID_ERROR = 0.001
"""A point whose distance by the grid is more than this is outside the object [m]."""


def exact_clearance(
    objects: list[ObjectModel],
    grid: np.ndarray,
    centers: np.ndarray,
    clearance: np.ndarray,
    radius: np.ndarray,
) -> np.ndarray:
    """Clearance of the spheres, shape [N, P]: exact, by the object's triangles, near the object; by the grid,
    which is up to a millimeter off, elsewhere.

    Args:
        objects: O of them.
        grid: index of each grasp's object, shape [N].
        centers: of the spheres, object frame [m], shape [N, P, 3].
        clearance: by the grid [m], shape [N, P].
        radius: of the spheres [m], shape [P].
    """
    near = np.abs(clearance) < EXACT_WITHIN
    nearest = nearest_surface_points(objects, grid, centers, near)
    inside = clearance + radius < 0
    distance = np.where(inside, -1.0, 1.0) * np.linalg.norm(centers - nearest, axis=-1)
    return np.where(near, distance - radius, clearance)


def penetration_depth(
    objects: list[ObjectModel],
    bank: SignedDistanceBank,
    grid: np.ndarray,
    centers: np.ndarray,
    clearance: np.ndarray,
    radius: np.ndarray,
    link: np.ndarray,
) -> np.ndarray:
    """Depth of the deepest point of the hand in the object [m], shape [N]. In a thin wall, or at an edge, it
    is less than how far a sphere reaches beyond the surface.

    Sampled in the two spheres of each link that reach farthest, in three rounds around the deepest sample so
    far.

    Args:
        bank: of the objects' grids.
        link: which link each sphere belongs to, shape [P].
        others: as for ``exact_clearance``.
    """
    rows, spheres = _deepest_spheres(clearance, link)
    best = np.zeros((len(rows), 1, 3))
    distance = np.zeros((len(rows), 1))
    pick = np.arange(len(rows))
    for around in (_BALL, 0.25 * _BALL, 0.06 * _BALL):
        samples = best + around
        samples /= np.maximum(1.0, np.linalg.norm(samples, axis=-1, keepdims=True))
        places = centers[rows, spheres][:, None] + radius[spheres][:, None, None] * samples
        distance = _signed_distance(objects, bank, grid[rows], places)
        best = samples[pick, distance.argmin(axis=1)][:, None]
    depth = np.zeros(len(grid))
    np.maximum.at(depth, rows, -distance.min(axis=1, initial=0.0))
    return depth


def _deepest_spheres(clearance: np.ndarray, link: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and indices of spheres that reach into the object: the two farthest of each link."""
    rows, spheres = [], []
    for number in np.unique(link):
        members = np.flatnonzero(link == number)
        order = members[np.argsort(clearance[:, members], axis=1)[:, :2]]
        row, place = np.nonzero(np.take_along_axis(clearance, order, axis=1) < 0)
        rows.append(row)
        spheres.append(order[row, place])
    return np.concatenate(rows), np.concatenate(spheres)


def _signed_distance(
    objects: list[ObjectModel], bank: SignedDistanceBank, grid: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Exact distance of points that may be inside, by the side of the nearest triangle they are on; by
    the grid for the others. points: shape [M, S, 3]; returns shape [M, S]."""
    rough, _ = bank.query(grid, points)
    near = rough < GRID_ERROR
    result = rough.copy()
    for number, model in enumerate(objects):
        chosen = near & (grid == number)[:, None]
        if chosen.any():
            nearest, face = nearest_on_mesh(model.mesh, points[chosen])
            away = points[chosen] - nearest
            outside = np.sum(away * model.mesh.face_normals[face], axis=1) > 0
            result[chosen] = np.where(outside, 1.0, -1.0) * np.linalg.norm(away, axis=1)
    return result


def nearest_surface_points(
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
    for number, model in enumerate(objects):
        chosen = which & (grid == number)[:, None]
        if chosen.any():
            result[chosen] = nearest_on_mesh(model.mesh, points[chosen])[0]
    return result


def _unit_ball(outer: int = 100, inner: int = 20) -> np.ndarray:
    """Points spread evenly over the unit sphere (a Fibonacci spiral), over one of half the size, and the
    center, shape [P, 3]."""
    shells = [np.zeros((1, 3))]
    for count, size in ((inner, 0.5), (outer, 1.0)):
        height = 1 - (2 * np.arange(count) + 1) / count
        turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        shells.append(size * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1))
    return np.concatenate(shells)


_BALL = _unit_ball()
