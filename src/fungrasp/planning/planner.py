"""What a planner is: from a robot grasp and a belief to a plan that can be inspected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

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
