"""The policy interface: ``Observation``, ``Action``, and ``Privileged`` for teachers and rewards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.task.grasp_plan import GraspPlan


@dataclass(frozen=True, eq=False, repr=False)
class Observation(BatchRecord):
    """Sensor data of W robots at a control step, the same in simulation and on robots.

    U is the number of independent joints; each has a servo.
    """

    time: np.ndarray
    """Time since the plan began [s], shape [W]."""
    time_since_lift: np.ndarray
    """Time since the lift began [s], -1 before, shape [W]."""
    joint_positions: np.ndarray
    """Measured independent joints [rad], shape [W, U]."""
    joint_setpoints: np.ndarray
    """Last servo setpoints [rad], shape [W, U]."""
    palm_pose: np.ndarray
    """Measured pose of the palm body, world frame, shape [W, 7]."""
    palm_setpoint: np.ndarray
    """Last setpoint of the palm, world frame, shape [W, 7]."""
    object_pose: np.ndarray
    """Tracked pose of the object, world frame, shape [W, 7]."""
    object_pose_age: np.ndarray
    """Age of the tracked pose [s], shape [W]."""


@dataclass(frozen=True, eq=False, repr=False)
class Privileged(BatchRecord):
    """Simulation state that no sensor measures, for W worlds and L contact links."""

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
    """Height of the object's center of mass above its settled height [m], shape [W]."""


@dataclass(frozen=True, eq=False, repr=False)
class Action(BatchRecord):
    """Action of W robots for the next control period."""

    FORMER_NAMES: ClassVar = {"palm_goal": "palm_goal_world"}

    palm_goal_world: np.ndarray
    """Goal of the palm body without the lift, world frame, shape [W, 7]. The wrist moves there within its
    speed limits."""
    finger_targets: np.ndarray
    """Targets of the finger servos at the end of the period [rad], shape [W, U]."""
    lift: np.ndarray
    """Whether to begin the lift, shape [W] bool. A lift cannot be undone."""


@runtime_checkable
class Policy(Protocol):
    """Controls W robots at the plan's control rate, in simulation and on robots."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """Begin new episodes.

        Args:
            plan: one plan per robot.
            observation: observation at the start of the episodes.
        """
        ...

    def act(self, observation: Observation) -> Action:
        """Return the action for the next control period. observation: at its start; the first one is that of
        ``reset``."""
        ...


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """A policy that also gets the privileged state, which exists only in simulation: a teacher."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """Begin new episodes; see ``Policy.reset``."""
        ...

    def act_privileged(self, observation: Observation, privileged: Privileged) -> Action:
        """Return the action for the next control period; see ``Policy.act``. privileged: at its start."""
        ...
