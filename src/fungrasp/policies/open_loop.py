"""A policy that plays plans open loop."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import compose
from fungrasp.task import Action, GraspPlan, Observation


def plan_step(plan: GraspPlan, observation: Observation) -> np.ndarray:
    """Return the number of control steps since the plan began, shape [W] int."""
    return np.rint(observation.time / plan.control_period).astype(int)


class OpenLoopPolicy:
    """Plays plans. It uses only the time of an observation."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """See ``Policy.reset``."""
        self._plan = plan

    def act(self, observation: Observation) -> Action:
        """See ``Policy.act``."""
        step = plan_step(self._plan, observation)
        goal, fingers = self._plan.at(step)
        return Action(compose(self._plan.object_pose, goal), fingers, step >= self._plan.lift_step)
