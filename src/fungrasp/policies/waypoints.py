"""A policy that takes hands along way points: between attempts, nothing is grasped."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import quaternion_conjugate, quaternion_multiply, rotation_vector
from fungrasp.planning.withdrawal import Waypoints
from fungrasp.task import Action, Observation

TURNED = 0.02
"""At the last point the palm's setpoint is turned as it should be to this angle [rad]."""


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
