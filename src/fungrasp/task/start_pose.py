"""Start poses of hands: away from the object, clear of it and of the table (docs/evaluate.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
)
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import palm_offset
from fungrasp.objects import ObjectModel
from fungrasp.task.hand_clearance import HandClearance

CLEARANCE = 0.01
"""Smallest distance of a hand from object and table at the start [m]."""

TURN_STEP = np.deg2rad(1.0)
"""Step of the search for a clear start pose [rad]."""

_LARGEST_TURN = np.pi / 2


def start_fingers(hand: Hand, grasps: RobotGraspSet, closing: float) -> np.ndarray:
    """Return the independent joints at the start [rad], shape [W, U].

    Args:
        grasps: W grasps.
        closing: fraction of the joint angles in the grasp.
    """
    return hand.independent(np.clip(closing * grasps.joint_positions, *hand.joint_limits.T))


def start_on_line(object_pose: np.ndarray, target: np.ndarray, distance: float | np.ndarray) -> np.ndarray:
    """Return palm poses with the grasp's orientation on the line from the object to the grasping palm.

    Args:
        object_pose: object poses, world frame, shape [W, 7].
        target: palm poses in the grasp, world frame, shape [W, 7].
        distance: distance from the objects' origins [m], a number or shape [W, 1].

    Returns:
        World frame, shape [W, 7].
    """
    start = target.copy()
    away = target[:, :3] - object_pose[:, :3]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    start[:, :3] = object_pose[:, :3] + distance * away
    return start


class StartPoses:
    """Start poses of W hands, each with its object."""

    def __init__(self, hand: Hand, models: Sequence[ObjectModel]):
        self._hand, self._models = hand, models
        bases = [finger.joints[0] for name, finger in hand.fingers.items() if name != "thumb"]
        self._offset = palm_offset(hand.model, hand.palm, bases)

    def facing(
        self,
        grasps: RobotGraspSet,
        object_index: np.ndarray,
        object_pose: np.ndarray,
        distance: float,
        fingers: np.ndarray,
        table_height: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return start poses on the lines from objects to grasping palms, turned upwards until they are
        clear.

        Args:
            grasps: W grasps.
            object_index: index in ``models`` of each object, shape [W].
            object_pose: poses of the objects at rest, world frame, shape [W, 7].
            distance: distance of the palms from the objects' origins [m]. If a palm's origin is far from the
                hand, a point near the hand counts (``palm_offset``).
            fingers: independent joints [rad], shape [W, U].
            table_height: height of the table top [m], shape [W].

        Returns:
            palm poses at the start and in the grasp, world frame, shape [W, 7] each.
        """
        target = compose(object_pose, grasps.wrist_pose_object)
        shift = rotate(target[:, 3:], np.tile(self._offset, (len(target), 1)))
        near = target.copy()
        near[:, :3] += shift
        start = start_on_line(object_pose, near, distance)
        start[:, :3] -= shift
        return self.clear(object_index, object_pose, start, fingers, table_height), target

    def clear(
        self,
        object_index: np.ndarray,
        object_pose: np.ndarray,
        start_pose: np.ndarray,
        fingers: np.ndarray,
        table_height: np.ndarray,
    ) -> np.ndarray:
        """Turn start poses upwards about the objects by the smallest angle that clears object and table.

        The angle is the smallest multiple of ``TURN_STEP`` up to 90 degrees. If no angle is clear, the one
        with the largest clearance is used.

        Args:
            object_index: index in ``models`` of each object, shape [W].
            object_pose: poses of the objects at rest, world frame, shape [W, 7].
            start_pose: palm poses, world frame, shape [W, 7].
            fingers: independent joints [rad], shape [W, U].
            table_height: height of the table top [m], shape [W].

        Returns:
            Palm poses, world frame, shape [W, 7].
        """
        clearance = HandClearance(self._hand, self._models, object_index)

        def gap(rows: np.ndarray, palm_pose: np.ndarray) -> np.ndarray:
            to_object, height = clearance.measure(rows, object_pose[rows], palm_pose, fingers[rows])
            return np.minimum(to_object, height - table_height[rows])

        result = start_pose.copy()
        best = gap(np.arange(len(result)), result)
        away = start_pose[:, :3] - object_pose[:, :3]
        # A small turn about this axis raises the palm on a sphere around the object.
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
            found = gap(rows, turned)
            better = found > best[rows]
            result[rows[better]], best[rows[better]] = turned[better], found[better]
            blocked = rows[best[rows] < CLEARANCE]
        return result
