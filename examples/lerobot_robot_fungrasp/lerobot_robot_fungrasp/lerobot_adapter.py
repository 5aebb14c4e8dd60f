"""A robot in the shape of LeRobot's ``Robot``; this file does not need LeRobot."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.robots.device import RobotError, SafetyStop, StopKind
from fungrasp.robots.robot import Robot
from fungrasp.robots.safety import action_problem
from fungrasp.task import Action

_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


class LeRobotRobot:
    """Flat dictionaries of numbers in place of ``Observation`` and ``Action``.

    ``send_action`` takes a control period less 20 ms, as it sends five setpoints: the loop around it waits
    for the rest.
    """

    name = "fungrasp"
    """Type of the robot."""

    def __init__(self, robot: Robot):
        """robot: not connected."""
        self._robot = robot
        self._joints = tuple(robot.hand.actuators)
        self._connected = False

    @property
    def is_connected(self) -> bool:
        """Whether ``connect`` was called."""
        return self._connected

    @property
    def observation_features(self) -> dict[str, type]:
        """Names of the observation's numbers."""
        places = [f"{what}.{part}" for what in ("palm", "object") for part in _POSE]
        joints = [f"{joint}.pos" for joint in self._joints]
        return dict.fromkeys([*places, "object.age", *joints], float)

    @property
    def action_features(self) -> dict[str, type]:
        """Names of the action's numbers; ``lift`` begins the lift where it is above a half."""
        return dict.fromkeys(
            [*(f"palm.{part}" for part in _POSE), *(f"{joint}.pos" for joint in self._joints), "lift"], float
        )

    @property
    def is_calibrated(self) -> bool:
        """Nothing is calibrated here: the cell's file holds what was measured."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    def connect(self, calibrate: bool = True) -> None:
        """Connect to all devices; setpoints begin where the robot stands. Nothing moves."""
        robot = self._robot
        robot.connect()
        robot.take_control()
        state = robot.state()
        robot.place_setpoints(state.arm.positions, state.hand.positions)
        robot.begin(state)
        self._connected = True

    def get_observation(self) -> dict[str, Any]:
        """What the sensors say now. Raises: RobotError: it is not connected, or the tracker has not seen the
        object yet."""
        self._check_connected()
        seen = self._robot.get_observation()
        numbers = [*seen.palm_pose[0], *seen.object_pose[0], *seen.object_pose_age, *seen.joint_positions[0]]
        return dict(zip(self.observation_features, map(float, numbers), strict=True))

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Do what is asked. Returns what was really sent.

        Raises:
            SafetyStop: the guard or the stop file stopped the robot: ``connect`` begins anew.
            RobotError: it is not connected, a number of the action is missing, or a device follows no more.
        """
        self._check_connected()
        missing = [name for name in self.action_features if name not in action]
        if missing:
            raise RobotError(f"the action lacks {', '.join(missing)}: it needs all of action_features")
        values = np.array([float(action[name]) for name in self.action_features])[None]
        asked, robot = Action(values[:, :7], values[:, 7:-1], values[:, -1] > 0.5), self._robot
        problem = action_problem(asked, robot.kinematics.palm_pose(robot.state().arm.positions), robot.cell)
        if problem:
            robot.stop()
            raise SafetyStop(problem, StopKind.HOLD)
        sent = robot.send_action(asked)
        numbers = [*sent.palm_goal_world[0], *sent.finger_targets[0], *sent.lift]
        return dict(zip(self.action_features, map(float, numbers), strict=True))

    def disconnect(self) -> None:
        """Stop and end all connections."""
        self._robot.close()
        self._connected = False

    def _check_connected(self) -> None:
        if not self._connected:
            raise RobotError("the robot is not connected: call connect() first")
