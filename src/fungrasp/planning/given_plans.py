"""Existing plans as a planner, for evaluation and deployment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import digest
from fungrasp.grasps import RobotGraspSet
from fungrasp.task import Belief, GraspPlan


class GivenPlans:
    """A planner with given plans. Each plan is moved to the believed pose of its object."""

    def __init__(self, plans: GraspPlan, grasps: RobotGraspSet):
        """
        Args:
            plans: one per grasp, in the same order.

        Raises:
            FungraspError: the plans are for other grasps.
        """
        if not isinstance(plans, GraspPlan):
            raise FungraspError(f"expected the plans of fungrasp.plan, not a {type(plans).__name__}")
        if len(plans) != len(grasps):
            raise FungraspError(f"there are {len(plans)} plans for {len(grasps)} grasps")
        if plans.hand != grasps.hand:
            raise FungraspError(f"the plans are of the hand '{plans.hand}', the grasps of '{grasps.hand}'")
        other = np.flatnonzero(plans.object_name != grasps.object_name)
        if len(other):
            row = int(other[0])
            raise FungraspError(
                f"row {row}: the plan is for the object '{plans.object_name[row]}', the grasp for "
                f"'{grasps.object_name[row]}'"
            )
        self.plans = plans
        self.key = digest(plans.arrays())
        """Digest of the plans."""

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """Return the plans for the believed object poses. grasps: all of them, in the order of the plans."""
        return replace(self.plans, object_pose=belief.object_pose.copy())

    def rows(self, rows: np.ndarray, belief: Belief) -> GraspPlan:
        """Return some of the plans. rows: indices, shape [I]; belief: I rows."""
        return replace(self.plans.select(rows), object_pose=belief.object_pose.copy())
