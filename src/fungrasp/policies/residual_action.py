"""Residual actions: corrections of the plan or of the current posture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import Array, array_namespace, clip, compose, quaternion_from_rotation_vector

WRIST_ACTIONS = 6
"""Number of wrist actions: translation along the palm's axes, then rotation about them. One action per finger
servo follows."""


Base = Literal["plan", "guided"]
"""What an action corrects."""


@dataclass(frozen=True)
class ResidualSettings(CheckedRecord):
    """Target and scale of residual actions."""

    base: Base = "plan"
    """"plan": actions correct the planned motion. "guided", as in the authors' released code: actions correct
    the wrist pose of the grasp, moved with the tracked object until the fingers close, and the measured
    joints; the plan gives only the grasp and the times of closing and lift."""

    position: float = 0.03
    """Shift of the wrist for an action of 1, along each axis [m]."""
    rotation: float = 0.15
    """Rotation of the wrist for an action of 1, about each axis [rad]."""
    fingers: float = 0.3
    """Change of each servo target for an action of 1 [rad]."""
    smoothing: float = 0.5
    """Weight of the previous action in the next one."""

    def shrunk(self, factor: float) -> ResidualSettings:
        """Scale the actions' corrections of the plan. Without a planned motion, the settings are unchanged.
        factor: above 0, at most 1.

        Raises:
            FungraspError: the factor is out of range.
        """
        if not 0 < factor <= 1:
            raise FungraspError(f"departures can be shrunk by a factor above 0 and at most 1, not {factor}")
        if self.base != "plan":
            return self
        scales = {name: factor * getattr(self, name) for name in ("position", "rotation", "fingers")}
        return replace(self, **scales)


def smoothed(action: Array, previous: Array, settings: ResidualSettings) -> Array:
    """Clip actions to [-1, 1] and smooth them. action: shape [W, A]; previous: last smoothed action."""
    return settings.smoothing * previous + (1.0 - settings.smoothing) * clip(action, -1.0, 1.0)


def add_residual(
    palm_goal_world: Array, servo_targets: Array, action: Array, settings: ResidualSettings
) -> tuple[Array, Array]:
    """Add a residual to palm goals, shape [W, 7], and servo targets, shape [W, U].

    Args:
        palm_goal_world: base of the palm goals, world frame, shape [W, 7].
        servo_targets: base of the servo targets [rad], shape [W, U].
        action: smoothed action, shape [W, 6 + U].
    """
    xp = array_namespace(action)
    turn = quaternion_from_rotation_vector(settings.rotation * action[:, 3:WRIST_ACTIONS])
    shift = xp.concat([settings.position * action[:, :3], turn], axis=-1)
    return compose(palm_goal_world, shift), servo_targets + settings.fingers * action[:, WRIST_ACTIONS:]
