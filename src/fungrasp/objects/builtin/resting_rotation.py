"""The rotation in which a built-in object rests on a table."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

FLAT = 1e-3
"""Normals whose angle is smaller belong to one face of the hull [rad]."""


def resting_rotation(vertices: np.ndarray, center_of_mass: np.ndarray) -> np.ndarray:
    """The smallest rotation after which an object is stable: its center of mass is above a face of its hull.

    Args:
        vertices: [m], shape [V, 3].
        center_of_mass: [m], shape [3].

    Returns:
        Rotation matrix, shape [3, 3]; the identity if it stands already.
    """
    hull = ConvexHull(vertices)
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    for row in np.argsort(normals[:, 2]):
        normal = normals[row]
        face = np.linalg.norm(normals - normal, axis=1) < FLAT
        foot = center_of_mass - (normal @ center_of_mass + offsets[row]) * normal
        if any(_inside(vertices[corners], foot, normal) for corners in hull.simplices[face]):
            if normal[2] < -1 + FLAT**2:
                return np.eye(3)
            return Rotation.align_vectors([[0, 0, -1]], [normal])[0].as_matrix()
    raise AssertionError("the center of mass lies inside the hull, so it is above one of its faces")


def _inside(triangle: np.ndarray, point: np.ndarray, normal: np.ndarray) -> bool:
    turns = [np.cross(triangle[(k + 1) % 3] - triangle[k], point - triangle[k]) @ normal for k in range(3)]
    return bool(min(turns) >= -1e-12 or max(turns) <= 1e-12)
