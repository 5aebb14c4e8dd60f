"""Errors of object poses: ADD, ADD-S and angle (Hinterstoisser et al., 2012; Xiang et al., 2018)."""

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
    """Return the mean distance of the object's points from their true positions [m], shape [...].

    ``ADD = mean over p of |T p - T* p|``.

    Args:
        points: points of the object's surface [m], object frame, shape [P, 3].
        pose: estimated poses, shape [..., 7].
        truth: true poses in the same frame, shape [..., 7]; broadcast with ``pose``.
    """
    apart = transform_points(pose, points) - transform_points(truth, points)
    return np.linalg.norm(apart, axis=-1).mean(axis=-1)


def add_s(points: np.ndarray, pose: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the mean distance of the true points from the *nearest* estimated ones [m], shape [...]; equal
    for poses that a symmetry of the object makes equal.

    ``ADD-S = mean over p of min over q of |T* p - T q|``.

    Args:
        points: points of the object's surface [m], object frame, shape [P, 3]; some thousand, because their
            spacing limits the resolution.
        pose, truth: as in ``add``.
    """
    moved = inverse_transform_points(pose, transform_points(truth, points))
    return np.asarray(KDTree(points).query(moved)[0]).mean(axis=-1)


def rotation_error(pose: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the angle between rotations [rad], shape [...]. pose, truth: shape [..., 7]."""
    between = quaternion_multiply(quaternion_conjugate(truth[..., 3:]), pose[..., 3:])
    return np.linalg.norm(rotation_vector(between), axis=-1)
