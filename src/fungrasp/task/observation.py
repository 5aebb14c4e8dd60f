"""What is seen: by every policy (``Observation``), and by a teacher and the reward only (``Privileged``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord


@dataclass(frozen=True, eq=False, repr=False)
class Observation(BatchRecord):
    """What W robots know at a control step. Simulated and real sensors produce the same.

    U is the number of the hand's independent joints, each with a servo.
    """

    time: np.ndarray
    """Time since the plan began [s], shape [W]."""
    time_since_lift: np.ndarray
    """Time since the lift began [s], -1 before, shape [W]."""
    joint_positions: np.ndarray
    """Measured independent joints [rad], shape [W, U]."""
    joint_setpoints: np.ndarray
    """Last setpoints of the joints' servos [rad], shape [W, U]."""
    palm_pose: np.ndarray
    """Measured pose of the palm body, world frame, shape [W, 7]."""
    palm_setpoint: np.ndarray
    """Last setpoint of the palm, world frame, shape [W, 7]."""
    object_pose: np.ndarray
    """Tracked pose of the object, world frame, shape [W, 7]."""
    object_pose_age: np.ndarray
    """How old the tracked pose is [s], shape [W]."""


@dataclass(frozen=True, eq=False, repr=False)
class Privileged(BatchRecord):
    """What only a simulation knows of W worlds; L contact links."""

    contacts: np.ndarray
    """Which links touch the object, shape [W, L] bool."""
    forces: np.ndarray
    """Net contact force of each link on the object [N], magnitude, shape [W, L]."""
    object_velocity: np.ndarray
    """Linear [m/s], then angular [rad/s] velocity of the object, world frame, shape [W, 6]."""
    table_forces: np.ndarray
    """Net contact force between each link and the table [N], magnitude, shape [W, L]."""
    self_force: np.ndarray
    """Net contact force of the hand with itself [N], magnitude, shape [W]."""
    object_on_table: np.ndarray
    """Whether the object touches the table, shape [W] bool."""
    object_mass: np.ndarray
    """True mass of the object [kg], shape [W]."""
    friction: np.ndarray
    """True sliding friction of hand, object and table, shape [W]."""
    lifted_height: np.ndarray
    """Height of the object's center of mass above where it settled [m], shape [W]."""
