"""What a planner is: from a robot grasp and a belief to a plan that can be inspected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.task import Belief, GraspPlan


class Planner(Protocol):
    """Plans grasps of one hand. A planner whose plans depend on ``key`` and the arguments of ``plan`` alone
    has that attribute, a str; only then partial results of an evaluation can be kept."""

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """Plan N grasps. What it cost is in the plan (``GraspPlan.rollouts``).

        Args:
            grasps: N grasps.
            belief: all that is known of their scenes, N rows.
            seed: of everything that the planner draws.
            progress: called with the number of grasps that are planned, fractions included.
        """
        ...


@runtime_checkable
class ConstrainedPlanner(Planner, Protocol):
    """A planner that chooses among plans which can be carried out."""

    def plan_within(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        feasible: Callable[[GraspPlan], np.ndarray],
        seed: int = 0,
    ) -> GraspPlan:
        """Plan N grasps. A plan that can't be carried out is chosen only where no other was found.

        Args:
            grasps: N grasps.
            belief: all that is known of their scenes, N rows.
            feasible: says of P plans which can be carried out, a bool array of shape [P]; plans of the
                grasps in turn, again and again.
            seed: of everything that the planner draws.
        """
        ...
