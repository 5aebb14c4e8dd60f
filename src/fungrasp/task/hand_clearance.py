"""How far hands are from their objects and tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.hands import Hand
from fungrasp.hands.collision_spheres import collision_spheres
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel


class HandClearance:
    """Measures W hands at once, each with its object."""

    def __init__(self, hand: Hand, models: Sequence[ObjectModel], object_index: np.ndarray):
        """
        Args:
            hand: the robot hand.
            models: objects.
            object_index: object of each of the W hands, as ``models`` has them, shape [W].
        """
        self._hand, self._spheres = hand, collision_spheres(hand)
        present, self._index = np.unique(object_index, return_inverse=True)
        self._bank = SignedDistanceBank([models[i].signed_distance for i in present])

    def measure(
        self,
        rows: np.ndarray,
        object_pose: np.ndarray,
        palm_pose: np.ndarray,
        joints: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Smallest distance of hands from their objects, and height of their lowest points [m], shape [I]
        each.

        Args:
            rows: which of the W hands, shape [I].
            object_pose: world frame, shape [I, 7].
            palm_pose: world frame, shape [I, 7].
            joints: independent joints [rad], shape [I, U].
        """
        kinematics = HandKinematics(self._hand, len(rows))
        kinematics.update(palm_pose, joints)
        centers, radius = kinematics.points(self._spheres.points), self._spheres.radius
        distance, _ = self._bank.query(self._index[rows], inverse_transform_points(object_pose, centers))
        return (distance - radius).min(axis=1), (centers[..., 2] - radius).min(axis=1)
