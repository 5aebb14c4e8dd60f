"""What a robot's devices say and are told, all together, and what may stop it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.robots.device import JointState, RobotError, StopKind, TrackedPose


@dataclass(frozen=True, eq=False)
class RobotState:
    """What all devices said last."""

    time: float
    """Time of the robot's clock [s]."""
    arm: JointState
    """Of the arm."""
    hand: JointState
    """Of the hand."""
    tracked: TrackedPose | None
    """Of the tracker; None before its first pose."""


@dataclass(frozen=True, eq=False)
class RobotCommand:
    """Setpoints of all servos."""

    arm: np.ndarray
    """Joints of the arm [rad], shape [A]."""
    hand: np.ndarray
    """Independent joints of the hand [rad], shape [U]; without any offset against gravity."""
    feedforward: np.ndarray
    """Torques that carry the hand's weight [N m], shape [U]."""
    palm: np.ndarray
    """Pose of the palm that the arm's joints stand for, world frame, shape [7]."""


class SafetyStop(RobotError):
    """The robot was stopped by its guard."""

    def __init__(self, reason: str, kind: StopKind = StopKind.HOLD):
        """
        Args:
            reason: what was wrong, as a phrase.
            kind: how motion ended.
        """
        super().__init__(f"the robot was stopped ({kind}): {reason}")
        self.reason, self.kind = reason, kind
