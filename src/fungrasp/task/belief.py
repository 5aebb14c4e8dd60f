"""Beliefs: what planners know before acting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.simulation.scene import NOMINAL_FRICTION


@dataclass(frozen=True, eq=False, repr=False)
class Belief(BatchRecord):
    """Estimated state and nominal parameters of N scenes at planning time. World frame: z up."""

    object_pose: np.ndarray
    """Pose of the object at rest on the table, shape [N, 7]."""
    object_mass: np.ndarray
    """Mass of the object [kg], shape [N]."""
    palm_pose: np.ndarray
    """Pose of the palm, shape [N, 7]."""
    joint_positions: np.ndarray
    """Positions of the independent joints [rad], shape [N, U]."""
    friction: np.ndarray
    """Sliding friction of hand, object and table, shape [N]."""
    table_height: np.ndarray
    """Height of the table top [m], shape [N]."""
    object_pose_covariance: np.ndarray | None = None
    """Covariance of the object's pose error: position [m], world frame, and rotation vector [rad], shape
    [N, 6, 6]; None for the rollouts' own distribution."""
    object_mass_spread: np.ndarray | None = None
    """Standard deviation of the logarithm of the object's mass, shape [N]; None for the rollouts' own
    distribution."""
    joint_damping: np.ndarray | None = None
    """Identified joint damping, as a factor on the model's, shape [N, M]; 1 if None."""
    servo_stiffness: np.ndarray | None = None
    """Identified servo stiffness, as a factor on the model's, shape [N, M]; 1 if None."""
    servo_damping: np.ndarray | None = None
    """Identified servo damping, as a factor on the model's, shape [N, M]; 1 if None."""

    @classmethod
    def nominal(
        cls,
        object_pose: np.ndarray,
        object_mass: np.ndarray,
        palm_pose: np.ndarray,
        joint_positions: np.ndarray,
    ) -> Belief:
        """Return a belief with nominal friction and a table at z = 0. Arguments: fields of the same names."""
        count = len(object_pose)
        friction, table = np.full(count, NOMINAL_FRICTION), np.zeros(count)
        return cls(object_pose, object_mass, palm_pose, joint_positions, friction, table)
