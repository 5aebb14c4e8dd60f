"""The interface of planners: from a robot grasp and a belief to a plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.task import Belief, GraspPlan


class Planner(Protocol):
    """Plans grasps of one hand. If plans depend only on the arguments of ``plan`` and on a str attribute
    ``key``, define this attribute: evaluations can then store partial results."""

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """Plan N grasps. The plan records the number of rollouts (``GraspPlan.rollouts``).

        Args:
            grasps: N grasps.
            belief: N rows.
            seed: random seed.
            progress: called with the number of planned grasps, fractions included.
        """
        ...


@runtime_checkable
class ConstrainedPlanner(Planner, Protocol):
    """A planner that selects only feasible plans."""

    def plan_within(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        feasible: Callable[[GraspPlan], np.ndarray],
        seed: int = 0,
    ) -> GraspPlan:
        """Plan N grasps. An infeasible plan is chosen only if there is no other.

        Args:
            grasps: N grasps.
            belief: N rows.
            feasible: function from P plans to a bool array of shape [P]; row p is a plan for grasp p mod N.
            seed: random seed.
        """
        ...
