"""Distances of hands from objects, and heights of their lowest points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry.arrays import constant, is_numpy
from fungrasp.geometry.poses import Array, array_namespace, inverse_transform_points, transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.hands import Hand
from fungrasp.hands.collisions import collision_spheres
from fungrasp.hands.kinematics import ArrayKinematics, HandKinematics
from fungrasp.objects import ObjectModel


class HandClearance:
    """Clearances of W hands, each with its own object."""

    def __init__(self, hand: Hand, models: Sequence[ObjectModel], object_index: np.ndarray):
        """
        Args:
            object_index: index in ``models`` of each hand's object, shape [W].
        """
        self._hand, self._models, self._spheres = hand, models, collision_spheres(hand)
        self._on_tensors = ArrayKinematics(hand, self._spheres.points)
        self._held, self._present = np.zeros(0, dtype=int), np.zeros(0, dtype=int)
        self.hold(object_index)

    def hold(self, object_index: np.ndarray) -> None:
        """Change the objects of the hands. object_index: as above; it is copied."""
        if np.array_equal(object_index, self._held):
            return
        present = np.union1d(self._present, object_index)
        if len(present) > len(self._present):
            self._bank = SignedDistanceBank([self._models[i].signed_distance for i in present])
        self._held, self._present = object_index.copy(), present
        self._index = np.searchsorted(present, object_index)

    def measure(
        self, rows: np.ndarray | slice, object_pose: Array, palm_pose: Array, joints: Array
    ) -> tuple[Array, Array]:
        """Return each hand's smallest distance from its object and the height of its lowest point [m], shape
        [I] each.

        Args:
            rows: indices of I hands; for tensors a slice.
            object_pose: world frame, shape [I, 7].
            palm_pose: world frame, shape [I, 7].
            joints: independent joints [rad], shape [I, U].
        """
        if is_numpy(joints):
            kinematics = HandKinematics(self._hand, len(joints))
            kinematics.update(palm_pose, joints)
            centers = kinematics.points(self._spheres.points)
        else:
            centers = transform_points(palm_pose, self._on_tensors.points(joints))
        radius, index = (constant(joints, given) for given in (self._spheres.radius, self._index[rows]))
        distance, _ = self._bank.query(index, inverse_transform_points(object_pose, centers))
        lowest = array_namespace(joints).min
        return lowest(distance - radius, axis=1), lowest(centers[..., 2] - radius, axis=1)
