"""Planes among measured points: proposed through three of them each, and fitted to those nearby.

A plane is ``[nx ny nz d]`` with a unit normal, ``n . x + d`` the height above it [m]; the camera, at the
origin, is above it.
"""

from __future__ import annotations

import numpy as np

NOISE = (0.004, 0.003)
"""Points this near to a plane [m], plus this times the squared depth [1/m], belong to it."""


def tolerance(depth: np.ndarray) -> np.ndarray:
    """How far a measured point may be from the plane that it belongs to [m], shape of ``depth`` [m]."""
    return NOISE[0] + NOISE[1] * depth**2


def planes_through(corners: np.ndarray) -> np.ndarray:
    """Planes through three points each; points in a line give none.

    Args:
        corners: [m], shape [T, 3, 3].

    Returns:
        Shape [P, 4], P <= T.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    offset = -np.einsum("ti,ti->t", normal, corners[:, 0])[:, None]
    kept = length[:, 0] > 1e-6
    planes = np.concatenate([normal, offset], axis=1)[kept] / length[kept]
    return planes * np.where(planes[:, 3:] < 0, -1.0, 1.0)


def votes(planes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many points belong to each plane, shape [P]. planes: shape [P, 4]; points: [m], shape [N, 3]."""
    heights = points @ planes[:, :3].T + planes[:, 3]
    return (np.abs(heights) < tolerance(points[:, 2])[:, None]).sum(axis=0)


def members(plane: np.ndarray, points: np.ndarray, width: float = 1.0) -> np.ndarray:
    """Which points belong to a plane, shape [N] bool. width: in the tolerance."""
    return np.abs(points @ plane[:3] + plane[3]) < width * tolerance(points[:, 2])


def fitted(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The plane fitted by least squares to the points that belong to it, a few times, shape [4]."""
    for width in (1.5, 1.0, 1.0):
        near = points[members(plane, points, width)]
        middle = near.mean(axis=0)
        direction = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
        plane = np.append(direction, -direction @ middle)
        plane = plane if plane[3] > 0 else -plane
    return plane
