"""Policies that play motions made before: plans open loop, whatever the object does, and ways along points,
between attempts, when nothing is grasped."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    quaternion_conjugate,
    quaternion_multiply,
    rotation_vector,
)
from fungrasp.planning.withdrawal import Waypoints
from fungrasp.task import Action, GraspPlan, Observation

TURNED = 0.02
"""At the last point the palm's setpoint is turned as it should be to this angle [rad]."""


def plan_step(plan: GraspPlan, observation: Observation) -> np.ndarray:
    """Control steps since the plan began, shape [W] int."""
    return np.rint(observation.time / plan.control_period).astype(int)


class OpenLoopPolicy:
    """Plays plans; of an observation it reads the clock alone."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """See ``Policy.reset``."""
        self._plan = plan

    def act(self, observation: Observation) -> Action:
        """See ``Policy.act``."""
        step = plan_step(self._plan, observation)
        goal, fingers = self._plan.at(step)
        return Action(compose(self._plan.object_pose, goal), fingers, step >= self._plan.lift_step)


class WaypointPolicy:
    """Goes from point to point as the palm's setpoint comes near, and stays at the last."""

    def __init__(self, ways: Waypoints):
        """ways: of W hands."""
        self._ways, self._at = ways, np.zeros(len(ways), dtype=int)
        self.arrived = np.zeros(len(ways), dtype=bool)
        """Whether the last point has been reached, shape [W] bool."""

    def act(self, observation: Observation) -> Action:
        """See ``Policy.act``."""
        ways, rows = self._ways, np.arange(len(self._at))
        last = ways.palm.shape[1] - 1
        goal, setpoint = ways.palm[rows, self._at], observation.palm_setpoint
        near = np.linalg.norm(goal[:, :3] - setpoint[:, :3], axis=1) < ways.near[rows, self._at]
        apart = rotation_vector(quaternion_multiply(quaternion_conjugate(goal[:, 3:]), setpoint[:, 3:]))
        turned = np.linalg.norm(apart, axis=1) < TURNED
        self.arrived |= (self._at == last) & near & turned
        self._at = np.minimum(self._at + near, last)
        return Action(
            ways.palm[rows, self._at], ways.fingers[rows, self._at], np.zeros(len(rows), dtype=bool)
        )
