"""What a robot does that no policy has a say in: looking where the object is, going from posture to posture,
putting down, withdrawing."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fungrasp.deployment.deployment_result import DeadlineMonitor
from fungrasp.deployment.preparation import PreparedGrasp
from fungrasp.deployment.spec import Phase
from fungrasp.geometry.poses import compose
from fungrasp.planning.withdrawal import WaypointPolicy, way_off
from fungrasp.robots.device import DeviceStatus, RobotError, RobotState, SafetyStop, StopKind, TrackedPose
from fungrasp.robots.kinematics.joint_path import timed_leg
from fungrasp.robots.robot import Robot
from fungrasp.robots.safety import check_pose
from fungrasp.task import Action, GraspPlan
from fungrasp.task.attempt_judge import average_pose

ARRIVED = 2e-3
"""A setpoint is where it should be if it is this near [m]: the hold begins as in the lift test."""

STILL = 0.05
"""A palm's setpoint that turns slower does not turn [rad/s]."""

LOWERED = 0.01
"""An object stands once the palm is measured this near to where it had taken it [m]: an arm that follows no
more is noticed only after a while."""

FINGER_SHARE = 0.2
"""Of their largest speed, for fingers that move before the arm does."""

OPEN_TIME = 1.5
"""Time in which the hand opens to let go [s]."""

LONGEST_PHASE = 30.0
"""A phase that takes longer on the plan's clock has failed [s]."""


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
                    raise RobotError(f"the {name} does not follow: {said}; start again")
            raise RobotError(f"the tracker sees no object for {WAIT_TIME:g} s: check its view")
        robot.check_switch()
        robot.clock.sleep_until(robot.clock.now() + 0.02)
        state = robot.state()
    while True:
        pose, state, problem = _looked(robot, seconds)
        if not problem:
            return pose, state
        # What rolls comes to rest, and a tracker may find its way back.
        if robot.clock.now() > deadline:
            raise RobotError(f"{problem}: check the tracker, then start again")


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


class ScriptedMotion:
    """Moves a robot as told, at the speed that it has been slowed down to, and watches its control steps."""

    def __init__(self, robot: Robot, ticks: DeadlineMonitor):
        """robot: connected. ticks: told of each control step."""
        self._robot, self._ticks = robot, ticks

    def move(self, corners: list[np.ndarray], fingers: np.ndarray) -> None:
        """Move the fingers while the arm stands still, then the arm from posture to posture: the way of the
        arm is clear for the fingers as they are then. corners: postures of the arm, the first one where it is
        [rad], each of shape [A]; fingers: independent joints [rad], shape [U]."""
        robot, period = self._robot, self._robot.setpoints.period
        robot.guard.reset()
        when = robot.now()

        def send(arm: np.ndarray, hand: np.ndarray) -> None:
            nonlocal when
            robot.wait(when)
            robot.send(arm, hand)
            when += period

        last = robot.hand_driver.read().positions
        step = robot.cell.limits.hand_speed * FINGER_SHARE * period * robot.leg_speed
        count = int(np.ceil(np.abs(fingers - last).max() / step))
        for i in range(count):
            send(corners[0], last + (i + 1) / count * (fingers - last))
        for start, end in pairwise(corners):
            for joints in timed_leg(start, end, robot.kinematics, robot.cell.limits, period, robot.leg_speed):
                send(joints, fingers)
        robot.place_setpoints(corners[-1], fingers)

    def put_down(self, prepared: PreparedGrasp, low: np.ndarray) -> None:
        """Lower the object, open the hand, withdraw along the way that the palm came. low: where the palm is
        when the object stands, world frame, shape [1, 7]."""
        robot, plan, period = self._robot, prepared.plan, self._robot.protocol.control_period
        robot.begin(robot.state())
        fingers = robot.setpoints.fingers.copy()
        start, step, opened = robot.now(), 0, 0.0

        def go(palm: np.ndarray, targets: np.ndarray) -> None:
            nonlocal step
            self._step(Phase.PUT_DOWN, start, step, Action(palm, targets, np.array([False])))
            step += 1

        closing = int(plan.closing_step[0])
        # As the approach had fingers and palm, step by step: those postures are clear of table and object.
        back = compose(plan.object_pose, plan.palm_setpoint_object[0, : closing + 1][::-1])
        opening = np.concatenate([prepared.start_fingers[None], plan.finger_targets[0, :closing]])[::-1]
        # The same goal until the object stands; then the hand opens.
        while opened < 1.0:
            if self.arrived(low, 0.0) and (opened or self._lowered(low)):
                opened = min(1.0, opened + period / OPEN_TIME)
            go(low, fingers + opened * (opening[:1] - fingers))
        # The palm follows its goals two steps behind; fingers that do not wait would be open too early.
        late = [*opening[:1], *opening[:1], *opening][: len(back)]
        for pose, targets in zip(back, late, strict=True):
            go(pose[None], targets[None])
        # The way home begins at rest.
        while not self.arrived(back[-1:], 0.0) or np.abs(robot.setpoints.wrist.turning).max() > STILL:
            go(back[-1:], prepared.start_fingers[None])

    def withdraw(self, plan: GraspPlan, gap: np.ndarray) -> None:
        """Open the hand over what is not held as it should be, and withdraw. gap: of the judge's verdict."""
        robot = self._robot
        state = robot.state()
        robot.begin(state)
        policy = WaypointPolicy(way_off(plan, robot.observation(state), gap))
        start, step = robot.now(), 0
        while True:
            action = policy.act(robot.get_observation())
            if policy.arrived.all():
                return
            self._step(Phase.WITHDRAW, start, step, action)
            step += 1

    def wait_for_tick(self, start: float, step: int) -> float:
        """Wait for a control step; the time of the motion [s]. start: of the first one. Raises: SafetyStop:
        the switch is pressed."""
        robot = self._robot
        planned = start + step * robot.control_period
        robot.sleep_until(planned)
        now = robot.now()
        self._ticks.record(planned, now)
        robot.check_switch()
        return now

    def arrived(self, goal: np.ndarray, above: float) -> bool:
        """Whether the palm's setpoint is at a goal, world frame, shape [1, 7], raised by a height [m]."""
        apart = goal[0, :3] + np.array([0.0, 0.0, above]) - self._robot.setpoints.wrist.pose[0, :3]
        return float(np.linalg.norm(apart)) < ARRIVED

    def _lowered(self, goal: np.ndarray) -> bool:
        """Whether the palm is measured at the height of a goal, shape [1, 7]."""
        palm = self._robot.kinematics.palm_pose(self._robot.arm.read().positions)
        return float(palm[2] - goal[0, 2]) < LOWERED

    def _step(self, phase: Phase, start: float, step: int, action: Action) -> None:
        """One control step."""
        self.wait_for_tick(start, step)
        self._robot.send_action(action, start + step * self._robot.control_period)
        self.check_length(phase, step)

    def check_length(self, phase: Phase, step: int) -> None:
        """Raises: SafetyStop: a phase has too many control steps."""
        if step * self._robot.protocol.control_period > LONGEST_PHASE:
            what = "grasp" if phase in (Phase.GRASP, Phase.LIFT, Phase.HOLD) else f"phase '{phase}'"
            raise SafetyStop(f"the {what} takes too long", StopKind.HOLD)
