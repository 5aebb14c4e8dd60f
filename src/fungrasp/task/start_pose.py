"""Where hands start: away from the object, and clear of it and of the table (docs/evaluate.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    invert,
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
"""Distance that hands keep from object and table as they start [m]."""

TURN_STEP = np.deg2rad(1.0)
"""Step in which starts are turned upwards [rad]."""

_LARGEST_TURN = np.pi / 2


def start_fingers(hand: Hand, grasps: RobotGraspSet, closing: float) -> np.ndarray:
    """Independent joints at the start [rad], shape [W, U].

    Args:
        grasps: W grasps.
        closing: the joints' fraction of their angles in the grasp.
    """
    return hand.independent(np.clip(closing * grasps.joint_positions, *hand.joint_limits.T))


def start_on_line(object_pose: np.ndarray, target: np.ndarray, distance: float | np.ndarray) -> np.ndarray:
    """Palm poses on the line from objects to where palms will grasp, turned as they will be.

    Args:
        object_pose: world frame, shape [W, 7].
        target: palm poses in the grasp, world frame, shape [W, 7].
        distance: from the objects' origins [m], one number or shape [W, 1].

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
        """Starts on the lines from objects to where palms will grasp, turned up until they are clear.

        Args:
            grasps: W grasps.
            object_index: object of each, as ``models`` has them, shape [W].
            object_pose: of the objects at rest, world frame, shape [W, 7].
            distance: of palms from the objects' origins [m]; where a palm's origin lies far from the hand,
                of a place near it (``palm_offset``).
            fingers: independent joints [rad], shape [W, U].
            table_height: of the table top [m], shape [W].

        Returns:
            the start and where the palm will grasp, world frame, shape [W, 7] each.
        """
        target = compose(object_pose, compose(invert(grasps.object_pose), grasps.wrist_pose))
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
        """Turn starts upwards about the objects, by the smallest angle that clears object and table.

        The angle is the smallest multiple of ``TURN_STEP`` up to a right angle; where none clears, the one
        that keeps farthest away is taken.

        Args:
            object_index: object of each, as ``models`` has them, shape [W].
            object_pose: of the objects at rest, world frame, shape [W, 7].
            start_pose: of the palm, world frame, shape [W, 7].
            fingers: independent joints [rad], shape [W, U].
            table_height: of the table top [m], shape [W].

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
            found = gap(rows, turned)
            better = found > best[rows]
            result[rows[better]], best[rows[better]] = turned[better], found[better]
            blocked = rows[best[rows] < CLEARANCE]
        return result
