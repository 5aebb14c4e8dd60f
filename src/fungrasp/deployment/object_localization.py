"""Where the object is, before anything is planned."""

from __future__ import annotations

import numpy as np

from fungrasp.robots.device import DeviceStatus, RobotError, RobotState, TrackedPose
from fungrasp.robots.robot import Robot
from fungrasp.robots.safety import check_pose
from fungrasp.task.attempt_judge import average_pose

WAIT_TIME = 10.0
"""Longest wait for the first pose of the object [s]."""


def locate_object(robot: Robot, seconds: float) -> tuple[np.ndarray, RobotState]:
    """Where the object rests, averaged over what the tracker says; and the robot's state.

    Args:
        robot: connected.
        seconds: for which poses are collected [s].

    Returns:
        Pose of the object, world frame, shape [7]; the state.

    Raises:
        RobotError: no pose comes that can be used, poses disagree, or a device does not follow.
        SafetyStop: the robot's switch was pressed.
    """
    state = robot.state()
    deadline = robot.clock.now() + WAIT_TIME
    while state.tracked is None or not robot.ready:
        if robot.clock.now() > deadline:
            for name, joints in (("arm", state.arm), ("hand", state.hand)):
                if joints.status is not DeviceStatus.READY:
                    said = f"{joints.status} {joints.message}".strip()
                    raise RobotError(f"the {name} does not follow: {said}; start anew")
            raise RobotError(f"the tracker sees no object for {WAIT_TIME:g} s: look where it looks")
        robot.check_switch()
        robot.clock.sleep_until(robot.clock.now() + 0.02)
        state = robot.state()
    while True:
        pose, state, problem = _looked(robot, seconds)
        if not problem:
            return pose, state
        # What rolls comes to rest, and a tracker may find its way back.
        if robot.clock.now() > deadline:
            raise RobotError(f"{problem}: look at the tracker, then start anew")


def _looked(robot: Robot, seconds: float) -> tuple[np.ndarray, RobotState, str]:
    """The average pose over some time, the state at its end, and what is wrong with the poses."""
    seen: list[TrackedPose] = []
    end, state = robot.clock.now() + seconds, robot.state()
    while robot.clock.now() < end:
        robot.clock.sleep_until(robot.clock.now() + 0.02)
        robot.check_switch()
        state = robot.state()
        assert state.tracked is not None
        seen.append(state.tracked)
    pose = average_pose(np.array([tracked.pose_world_object for tracked in seen]))
    problem = check_pose(state.tracked, pose, robot.clock.now(), robot.cell)
    for tracked in seen:
        problem = problem or check_pose(tracked, pose, tracked.captured, robot.cell)
    return pose, state, problem
