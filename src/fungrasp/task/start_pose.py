"""Where hands start: away from the object, and clear of it and of the table (docs/evaluation.md)."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
)
from fungrasp.hands.collision_spheres import collision_spheres
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.simulation import Scene

CLEARANCE = 0.01
"""Distance that hands keep from object and table as they start [m]."""

TURN_STEP = np.deg2rad(1.0)
"""Step in which starts are turned upwards [rad]."""

_LARGEST_TURN = np.pi / 2


def start_on_line(object_pose: np.ndarray, target: np.ndarray, distance: float) -> np.ndarray:
    """Palm poses on the line from objects to where palms will grasp, turned as they will be.

    Args:
        object_pose: world frame, shape [W, 7].
        target: palm poses in the grasp, world frame, shape [W, 7].
        distance: from the objects' origins [m].

    Returns:
        World frame, shape [W, 7].
    """
    start = target.copy()
    away = target[:, :3] - object_pose[:, :3]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    start[:, :3] = object_pose[:, :3] + distance * away
    return start


class StartPoses:
    """Start poses of hands in W worlds of a scene."""

    def __init__(self, scene: Scene):
        """scene: with the hand and the objects."""
        self._hand = scene.hand
        self._spheres = collision_spheres(scene.hand)
        self._models = scene.models

    def clear(
        self,
        object_index: np.ndarray,
        object_pose: np.ndarray,
        start_pose: np.ndarray,
        fingers: np.ndarray,
        table_height: np.ndarray,
    ) -> np.ndarray:
        """Turn starts upwards about the objects, by the smallest angle that clears object and table.

        The angle is the smallest multiple of ``TURN_STEP`` up to a right angle; where none clears, the one
        that keeps farthest away is taken.

        Args:
            object_index: object of each world, as the scene numbers them, shape [W].
            object_pose: of the objects at rest, world frame, shape [W, 7].
            start_pose: of the palm, world frame, shape [W, 7].
            fingers: independent joints [rad], shape [W, U].
            table_height: of the table top [m], shape [W].

        Returns:
            Palm poses, world frame, shape [W, 7].
        """
        present, index = np.unique(object_index, return_inverse=True)
        bank = SignedDistanceBank([self._models[i].signed_distance for i in present])
        result = start_pose.copy()
        best = self._clearance(bank, index, object_pose, result, fingers, table_height)
        away = start_pose[:, :3] - object_pose[:, :3]
        # About this axis, a small turn raises the palm on its sphere around the object.
        axis = np.cross(away, np.array([0.0, 0.0, 1.0]))
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        axis = np.where(length > 1e-9, axis / np.maximum(length, 1e-9), [0.0, 1.0, 0.0])
        blocked = np.flatnonzero(best < CLEARANCE)
        for step in range(1, round(_LARGEST_TURN / TURN_STEP) + 1):
            if not len(blocked):
                break
            rows = blocked
            turn = quaternion_from_rotation_vector(step * TURN_STEP * axis[rows])
            turned = np.concatenate(
                [
                    object_pose[rows, :3] + rotate(turn, away[rows]),
                    quaternion_multiply(turn, start_pose[rows, 3:]),
                ],
                axis=1,
            )
            gap = self._clearance(
                bank, index[rows], object_pose[rows], turned, fingers[rows], table_height[rows]
            )
            better = gap > best[rows]
            result[rows[better]], best[rows[better]] = turned[better], gap[better]
            blocked = rows[best[rows] < CLEARANCE]
        return result

    def _clearance(
        self,
        bank: SignedDistanceBank,
        index: np.ndarray,
        object_pose: np.ndarray,
        palm_pose: np.ndarray,
        fingers: np.ndarray,
        table_height: np.ndarray,
    ) -> np.ndarray:
        """Smallest distance of each hand from its object and its table [m], shape [W]."""
        kinematics = HandKinematics(self._hand, len(palm_pose))
        kinematics.update(palm_pose, fingers)
        centers, radius = kinematics.points(self._spheres.points), self._spheres.radius
        above = (centers[..., 2] - table_height[:, None] - radius).min(axis=1)
        distance, _ = bank.query(index, inverse_transform_points(object_pose, centers))
        return np.minimum(above, (distance - radius).min(axis=1))
