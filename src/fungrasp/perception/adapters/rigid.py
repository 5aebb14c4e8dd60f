"""Poses as other programs write them, checked: 4 x 4 matrices, rotation and translation, our 7 numbers."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.errors import FungraspError
from fungrasp.perception.io.capture import DEPTH_LIMIT

TOLERANCE = 0.02
"""How far a rotation may be from one, in any element of ``R^T R - 1``; then the nearest rotation is taken."""

UNIT_TOLERANCE = 0.001
"""How far a quaternion's length may be from 1."""

NEAREST = 0.02
"""No camera sees an object nearer than this [m]."""


def pose_from_numbers(numbers: np.ndarray, where: str) -> np.ndarray:
    """The pose of an object in the camera frame, shape [7], from whatever numbers a file holds.

    Args:
        numbers: 4 x 4, 3 x 4, 16 or 12 in a row (a matrix, row by row), or 7: ``[x y z qw qx qy qz]``; [m].
        where: name of the file and the row, for messages.

    Raises:
        FungraspError: another number of them, not finite, no rotation, or not where a camera could see it.
    """
    numbers = np.asarray(numbers, dtype=float)
    if not np.isfinite(numbers).all():
        raise FungraspError(f"{where}: the pose has non-finite numbers")
    if numbers.size == 7:
        return _from_quaternion(numbers.ravel(), where)
    if numbers.size not in (12, 16):
        raise FungraspError(
            f"{where}: a pose is a 4 x 4 matrix or 7 numbers (x y z qw qx qy qz), not an array of shape "
            f"{list(numbers.shape)}"
        )
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        transposed = np.allclose(matrix[:, 3], [0, 0, 0, 1], atol=1e-6)
        hint = "; it is transposed" if transposed else ""
        raise FungraspError(f"{where}: the last row of the 4 x 4 matrix must be 0 0 0 1{hint}")
    return pose_from_rotation(matrix[:3, :3], matrix[:3, 3], where)


def pose_from_rotation(rotation: np.ndarray, translation: np.ndarray, where: str) -> np.ndarray:
    """The pose, shape [7], of a rotation matrix and a translation [m]. Raises as ``pose_from_numbers``."""
    if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        raise FungraspError(f"{where}: the pose has non-finite numbers")
    determinant = float(np.linalg.det(rotation))
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if determinant < 0 and abs(determinant + 1) < 3 * TOLERANCE:
        raise FungraspError(
            f"{where}: the matrix mirrors (its determinant is {determinant:.3g}), it is no rotation: is one "
            "axis of the camera or of the object turned round?"
        )
    if error > TOLERANCE:
        raise FungraspError(f"{where}: {_why_no_rotation(rotation, determinant, error)}")
    _check_position(translation, where)
    quaternion = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([translation, quaternion])


def _why_no_rotation(rotation: np.ndarray, determinant: float, error: float) -> str:
    if determinant > 0:
        scale = determinant ** (1 / 3)
        if np.abs(rotation.T @ rotation / scale**2 - np.eye(3)).max() < TOLERANCE:
            return (
                f"the matrix scales by {scale:.4g}, it is no rotation: scale the mesh instead, and take "
                "the scale out of the matrix"
            )
    return (
        "the matrix is no rotation: its columns are not perpendicular or not of length 1 (off by "
        f"{error:.2g}, determinant {determinant:.3g})"
    )


def _from_quaternion(numbers: np.ndarray, where: str) -> np.ndarray:
    length = float(np.linalg.norm(numbers[3:]))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise FungraspError(
            f"{where}: the quaternion of the pose x y z qw qx qy qz has length {length:.4g}, not 1"
        )
    _check_position(numbers[:3], where)
    return np.concatenate([numbers[:3], numbers[3:] / length])


def _check_position(position: np.ndarray, where: str) -> None:
    x, y, z = position
    if z < 0:
        raise FungraspError(
            f"{where}: the object is behind the camera (z = {z:.4g} m): its pose must be in the camera frame "
            "with x right, y down, z forward; is it the pose of the camera in the object's frame, or are y "
            "and z those of OpenGL?"
        )
    if z > DEPTH_LIMIT:
        raise FungraspError(
            f"{where}: the object is {z:.4g} m from the camera: were millimetres taken for metres?"
        )
    if z < NEAREST:
        raise FungraspError(
            f"{where}: the object is {1000 * z:.3g} mm from the camera; no camera sees that near: is the "
            "pose in another unit?"
        )
    if np.hypot(x, y) > 5 * z:
        raise FungraspError(
            f"{where}: the object is at x = {x:.3g}, y = {y:.3g}, z = {z:.3g} m, far outside any camera's "
            "view"
        )
