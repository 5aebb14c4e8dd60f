"""Directions of a use motion, from the pose of the held object."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import inverse_transform_points, rotate, rotation_matrix
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel

_UP = np.array([0.0, 0.0, 1.0])


def far_end(model: ObjectModel, object_pose: np.ndarray, palm_pose: np.ndarray) -> np.ndarray:
    """Return the vertex of an object farthest from the palm, object frame [m], shape [3].

    Args:
        object_pose: world frame, shape [7].
        palm_pose: world frame, shape [7].
    """
    palm = inverse_transform_points(object_pose[None], palm_pose[None, None, :3])[0, 0]
    return model.vertices[np.argmax(np.linalg.norm(model.vertices - palm, axis=1))]


def horizontal(direction: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return the unit vector of a direction's horizontal part; if the direction is within 30 degrees of the
    vertical, that of another direction. Both: unit vectors, world frame, shape [3]."""
    for vector in (direction, otherwise, np.array([1.0, 0.0, 0.0])):
        flat = vector * [1.0, 1.0, 0.0]
        if np.linalg.norm(flat) > 0.5:
            return flat / np.linalg.norm(flat)
    raise AssertionError("the last one is horizontal")


def turn_axis(kind: str, hand: Hand, palm_pose: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the axis about which the palm turns, unit vector, world frame, shape [3].

    Args:
        kind: "tilt" or "swing".
        palm_pose: world frame, shape [7].
        end: far end of the object, world frame [m], shape [3].
    """
    facing, ahead = (rotate(palm_pose[3:], v) for v in (hand.palm_normal, hand.palm_fingers))
    if kind == "tilt":
        return np.cross(_UP, horizontal(facing, ahead))
    reach = (end - palm_pose[:3]) / np.linalg.norm(end - palm_pose[:3])
    return np.cross(_UP, horizontal(reach, facing))


def turning_frame(axis: np.ndarray, palm_pose: np.ndarray) -> np.ndarray:
    """Return the reference frame of the wrist's joints for a turn about an axis; world frame, shape [7]. It
    keeps the wrist's three hinges away from their singularity.

    The hinges are x, y, z from the frame outwards. The first and the last coincide where the palm's z is
    along the frame's x. If the axis is far from the palm's z, it becomes the first hinge; otherwise the last.

    Args:
        axis: unit vector, world frame, shape [3].
        palm_pose: palm pose at the start of the turn, world frame, shape [7].
    """
    x, _, z = rotation_matrix(palm_pose[3:]).T
    if abs(axis @ z) < np.sqrt(0.5):
        first, second = axis, np.cross(z, axis)
    else:
        third = axis * np.sign(axis @ z)
        first = x - (x @ third) * third
        second = np.cross(third, first)
    first, second = (v / np.linalg.norm(v) for v in (first, second))
    rotation = np.stack([first, second, np.cross(first, second)], axis=1)
    return np.concatenate([palm_pose[:3], Rotation.from_matrix(rotation).as_quat(scalar_first=True)])
