"""Where the object is, before anything is planned."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fungrasp.deployment.deployment_result import DeploymentSettings
from fungrasp.robots.device import DeviceStatus, RobotError
from fungrasp.robots.robot import Robot
from fungrasp.robots.robot_state import RobotState
from fungrasp.robots.safety import check_pose
from fungrasp.task.attempt_judge import average_pose


def look_for_object(
    robot: Robot, settings: DeploymentSettings, check: Callable[[], None]
) -> tuple[np.ndarray, RobotState]:
    """Where the object rests, averaged over what the tracker says; and the robot's state.

    Args:
        robot: connected.
        settings: how long to wait and to look.
        check: called now and then; raises to stop.

    Returns:
        Pose of the object, world frame, shape [7]; the state.

    Raises:
        RobotError: no pose comes that can be used, or a device does not follow.
    """
    s = settings
    state = robot.state()
    deadline = robot.clock.now() + s.wait_time
    while state.tracked is None or not robot.ready:
        if robot.clock.now() > deadline:
            for name, joints in (("arm", state.arm), ("hand", state.hand)):
                if joints.status is not DeviceStatus.READY:
                    said = f"{joints.status} {joints.message}".strip()
                    raise RobotError(f"the {name} does not follow: {said}; start anew")
            raise RobotError(f"the tracker sees no object for {s.wait_time:g} s: look where it looks")
        check()
        robot.clock.sleep_until(robot.clock.now() + 0.02)
        state = robot.state()
    poses, end = [], robot.clock.now() + s.look_time
    while robot.clock.now() < end:
        robot.clock.sleep_until(robot.clock.now() + 0.02)
        state = robot.state()
        assert state.tracked is not None
        poses.append(state.tracked.pose_world_object)
    problem = check_pose(state.tracked, average_pose(np.array(poses)), robot.clock.now(), robot.cell)
    if problem:
        raise RobotError(f"{problem}: look at the tracker, then start anew")
    return average_pose(np.array(poses)), state
