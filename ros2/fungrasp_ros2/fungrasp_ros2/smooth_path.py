"""Setpoints between goals that keep limits of speed, acceleration and jerk: forward controllers have none."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.robots.device import RobotError, import_client


class SmoothPath:
    """A path of joints that goes on from setpoint to setpoint (ruckig)."""

    def __init__(
        self, positions: np.ndarray, period: float, velocity: float, acceleration: float, jerk: float
    ):
        """
        Args:
            positions: where it begins, at rest [rad], shape [U].
            period: between setpoints [s].
            velocity: highest of a joint [rad/s].
            acceleration: highest of a joint [rad/s^2].
            jerk: highest of a joint [rad/s^3].
        """
        self._ruckig = import_client("ruckig", "ur", "an arm that is led by setpoints")
        count, self._velocity = len(positions), velocity
        self._solver, self._step = self._ruckig.Ruckig(count, period), self._ruckig.OutputParameter(count)
        lead: Any = self._ruckig.InputParameter(count)
        lead.current_position = positions.tolist()
        for name in ("current_velocity", "current_acceleration", "target_velocity", "target_acceleration"):
            setattr(lead, name, [0.0] * count)
        lead.max_velocity, lead.max_acceleration = [velocity] * count, [acceleration] * count
        lead.max_jerk = [jerk] * count
        lead.synchronization = self._ruckig.Synchronization.No
        self._lead = lead

    @property
    def resting(self) -> bool:
        """Whether the last setpoint does not move."""
        return max(map(abs, self._lead.current_velocity)) < 1e-9

    def follow(self, goal: np.ndarray, speed: float = np.inf) -> np.ndarray:
        """The next setpoint on the way to a goal [rad], shape [U].

        Args:
            goal: [rad], shape [U].
            speed: highest of a joint, below the path's own [rad/s].
        """
        self._lead.max_velocity = [min(self._velocity, speed)] * len(goal)
        self._lead.control_interface = self._ruckig.ControlInterface.Position
        self._lead.target_position = goal.tolist()
        return self._next()

    def brake(self) -> np.ndarray:
        """The next setpoint on the way to rest [rad], shape [U]."""
        self._lead.control_interface = self._ruckig.ControlInterface.Velocity
        return self._next()

    def _next(self) -> np.ndarray:
        result = self._solver.update(self._lead, self._step)
        if result not in (self._ruckig.Result.Working, self._ruckig.Result.Finished):
            raise RobotError(f"no path to the goal within the limits ({result})")
        self._step.pass_to_input(self._lead)
        return np.array(self._step.new_position)
