"""What a policy is, what it sees (``Observation``; a teacher and the reward also ``Privileged``), and what it
does (``Action``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.task.grasp_plan import GraspPlan


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


@dataclass(frozen=True, eq=False, repr=False)
class Action(BatchRecord):
    """What a policy asks of W robots during the next control period."""

    FORMER_NAMES: ClassVar = {"palm_goal": "palm_goal_world"}

    palm_goal_world: np.ndarray
    """Goal of the palm body, world frame, before any lift is added, shape [W, 7]. The wrist moves there
    within its speed limits."""
    finger_targets: np.ndarray
    """Targets of the finger servos at the end of the period [rad], shape [W, U]."""
    lift: np.ndarray
    """Whether the lift may begin (it can't be taken back), shape [W] bool."""


@runtime_checkable
class Policy(Protocol):
    """Acts for W robots at the plan's control rate, in simulation and on robots alike."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """Begin new episodes.

        Args:
            plan: what to follow, one for each robot.
            observation: what is seen as the episodes begin.
        """
        ...

    def act(self, observation: Observation) -> Action:
        """What to do in the next control period. observation: at its beginning; the first is that of
        ``reset``."""
        ...


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """A policy that also gets the privileged state, which only a simulation knows: a teacher."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """Begin new episodes, see ``Policy.reset``."""
        ...

    def act_privileged(self, observation: Observation, privileged: Privileged) -> Action:
        """What to do in the next control period, see ``Policy.act``. privileged: at the beginning of the
        control period."""
        ...
