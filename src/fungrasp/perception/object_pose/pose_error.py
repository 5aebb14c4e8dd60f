"""How wrong a pose of an object is: ADD, ADD-S and the angle (Hinterstoisser et al., 2012; Xiang et al.,
2018).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_conjugate,
    quaternion_multiply,
    rotation_vector,
    transform_points,
)


def add(points: np.ndarray, pose: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Average distance of the object's points from where they truly are [m].

    ``ADD = mean over p of |T p - T* p|``.

    Args:
        points: of the object's surface [m], shape [P, 3], object frame.
        pose: estimated, shape [..., 7].
        truth: in the same frame as ``pose``, shape [..., 7]; they broadcast.

    Returns:
        [m], shape [...].
    """
    apart = transform_points(pose, points) - transform_points(truth, points)
    return np.linalg.norm(apart, axis=-1).mean(axis=-1)


def add_s(points: np.ndarray, pose: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Average distance from the true points to the *nearest* estimated one [m]: the same for
    all poses that a symmetry of the object makes equal.

    ``ADD-S = mean over p of min over q of |T* p - T q|``.

    Args:
        points: of the object's surface [m], shape [P, 3], object frame; take some thousand, as the gaps
            between them are the smallest error that shows.
        pose: estimated, shape [..., 7].
        truth: in the same frame as ``pose``, shape [..., 7]; they broadcast.

    Returns:
        [m], shape [...].
    """
    moved = inverse_transform_points(pose, transform_points(truth, points))
    return np.asarray(KDTree(points).query(moved)[0]).mean(axis=-1)


def rotation_error(pose: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Angle between the two rotations [rad], shape [...]. pose, truth: shape [..., 7]."""
    between = quaternion_multiply(quaternion_conjugate(truth[..., 3:]), pose[..., 3:])
    return np.linalg.norm(rotation_vector(between), axis=-1)
