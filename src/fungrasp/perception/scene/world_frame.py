"""Where the world is, seen from a camera: the table, or a guess where none is in the image.

World frame: z up, the table top is z = 0, the origin below the object's centre of mass. As one looks through
the camera, x points to the right along the table and y away from the camera.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import (
    compose,
    quaternion_conjugate,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.objects import ObjectModel
from fungrasp.objects.resting_pose import settled_up

STEEP = 0.3
"""A camera that looks down more steeply, by the sine of the angle between its axis and the vertical, has no
direction along the table; up in the image then counts as away."""

Z = np.array([0.0, 0.0, 1.0])


def guessed_table(points: np.ndarray) -> np.ndarray:
    """A level plane below everything, for a camera that is held level.

    Args:
        points: of hand and object [m], camera frame, shape [P, 3].

    Returns:
        ``[nx ny nz d]``: ``n . x + d`` is the height above it [m], shape [4].
    """
    return np.array([0.0, -1.0, 0.0, float(points[:, 1].max())])


def world_from_table(table: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Pose of the camera in the world, shape [7].

    Args:
        table: ``[nx ny nz d]``, camera frame, unit normal upwards, shape [4].
        below: point above the world's origin [m], camera frame, shape [3].
    """
    up = table[:3] / np.linalg.norm(table[:3])
    away = Z - up * up[2]
    if np.linalg.norm(away) < STEEP:
        away = np.array([0.0, -1.0, 0.0])
        away = away - up * (up @ away)
    away = away / np.linalg.norm(away)
    turn = np.stack([np.cross(away, up), away, up])
    origin = below - up * (up @ below + table[3])
    quaternion = Rotation.from_matrix(turn).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([-turn @ origin, quaternion])


def put_down(model: ObjectModel, pose: np.ndarray) -> np.ndarray:
    """The object let down: turned onto its nearest stable face, lying on the table, shape [7].

    Its centre of mass stays above the same spot.

    Args:
        model: the object.
        pose: as it is held, world frame, shape [7].
    """
    face_up = rotate(pose[3:], settled_up(model, rotate(quaternion_conjugate(pose[3:]), Z)))
    turn = Rotation.align_vectors(Z[None], face_up[None])[0].as_quat(scalar_first=True)
    laid = np.concatenate([np.zeros(3), quaternion_multiply(turn, pose[3:])])
    centre = transform_points(pose, model.center_of_mass[None])[0]
    offset = centre - transform_points(laid, model.center_of_mass[None])[0]
    lowest = transform_points(laid, model.vertices)[:, 2].min()
    return np.concatenate([[offset[0], offset[1], -lowest], laid[3:] / np.linalg.norm(laid[3:])])


def in_world(pose_world_camera: np.ndarray, pose_camera: np.ndarray) -> np.ndarray:
    """A pose of the camera frame in the world, shape [7], its quaternion of unit length and positive w."""
    pose = compose(pose_world_camera, pose_camera)
    quaternion = pose[3:] / np.linalg.norm(pose[3:])
    return np.concatenate([pose[:3], quaternion * (1.0 if quaternion[0] >= 0 else -1.0)])
