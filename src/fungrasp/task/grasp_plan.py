"""Plans: targets of wrist and fingers at every control step, and the intended grasp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.arrays import is_numpy
from fungrasp.geometry.poses import clip


@dataclass(frozen=True, eq=False, repr=False)
class GraspPlan(BatchRecord):
    """Plans of N grasps with T control steps each. After the last step, targets stay constant.

    Motions are relative to the frame of the resting object, so a plan moves with the object.
    """

    SCALARS: ClassVar[tuple[str, ...]] = ("hand", "control_period")
    FORMER_NAMES: ClassVar = {"palm_goal": "palm_goal_object", "palm_setpoint": "palm_setpoint_object"}
    _STEPPED: ClassVar[tuple[str, ...]] = (
        "palm_goal_object",
        "finger_targets",
        "palm_setpoint_object",
        "palm_velocity",
    )

    hand: str
    """Name of the hand."""
    control_period: float
    """Time between two control steps [s]."""
    object_name: np.ndarray
    """Name of each object, shape [N] str."""
    object_mass: np.ndarray
    """Assumed mass of the object [kg], shape [N]."""
    object_pose: np.ndarray
    """Assumed pose of the resting object, world frame, shape [N, 7]."""
    link_contacts: np.ndarray
    """Links that should touch the object, shape [N, L] bool."""
    keypoints: np.ndarray
    """Key points of the hand in the grasp, object frame [m], shape [N, K, 3]."""
    grasp_palm_pose: np.ndarray
    """Palm pose in the grasp, object frame, shape [N, 7]."""
    grasp_joints: np.ndarray
    """Angles of the independent joints in the grasp [rad], shape [N, U]."""
    palm_goal_object: np.ndarray
    """Goal of the palm at each step, without the lift, object frame, shape [N, T, 7]."""
    finger_targets: np.ndarray
    """Targets of the finger servos at each step [rad], shape [N, T, U]."""
    palm_setpoint_object: np.ndarray
    """Setpoint of the palm at the start of each step, object frame, shape [N, T, 7]."""
    palm_velocity: np.ndarray
    """Velocity of that setpoint, world frame [m/s], shape [N, T, 3]."""
    closing_step: np.ndarray
    """Step at which the fingers start to close, shape [N] int."""
    lift_step: np.ndarray
    """First step of the lift, shape [N] int."""
    path_collision: np.ndarray
    """Largest violation of the margins around object and table along the path [m], shape [N]."""
    shown_places: np.ndarray | None = None
    """The person's contacts by finger link (``RobotGraspSet``), object frame [m], shape [N, L - 1, 3]; None
    if unknown."""
    shown_normals: np.ndarray | None = None
    """Outward unit normals of the surface at these contacts, shape [N, L - 1, 3]."""
    expected_success: np.ndarray | None = None
    """Planner's estimate of the success probability, shape [N]; None without estimate."""
    expected_as_shown: np.ndarray | None = None
    """Planner's estimate of the probability to hold as shown, shape [N]; None without estimate."""
    rollouts: np.ndarray | None = None
    """Simulated episodes used to plan each grasp, shape [N] int; None if there were none."""

    def at(self, step: np.ndarray, rows: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Return palm goals, object frame, shape [I, 7], and finger targets [rad], shape [I, U].

        Args:
            step: control step of each row, shape [I] int; clipped to the last step.
            rows: I rows; all by default.
        """
        step = clip(step, 0, self.palm_goal_object.shape[1] - 1)
        index = np.arange(len(self))[rows] if is_numpy(step) else rows
        return self.palm_goal_object[index, step], self.finger_targets[index, step]

    def raised(self, height: np.ndarray) -> GraspPlan:
        """Return the plans for objects that rest higher. height: difference [m], shape [N]."""
        pose = self.object_pose.copy()
        pose[:, 2] += height
        return replace(self, object_pose=pose)

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Concatenate plans; shorter plans repeat their last step."""
        length = max(part.palm_goal_object.shape[1] for part in parts)
        return super().join([part._padded(length) for part in parts])

    def _padded(self, length: int) -> Self:
        def pad(values: np.ndarray) -> np.ndarray:
            missing = length - values.shape[1]
            return np.concatenate([values, np.repeat(values[:, -1:], missing, axis=1)], axis=1)

        return replace(self, **{name: pad(getattr(self, name)) for name in self._STEPPED})
