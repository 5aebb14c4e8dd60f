"""Robot motions without a policy: locating the object, moving between postures, putting down, withdrawing."""

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
"""Distance from its goal at which a setpoint has arrived [m], as in the lift test."""

STILL = 0.05
"""Angular speed below which the palm's setpoint is at rest [rad/s]."""

LOWERED = 0.01
"""Measured height of the palm above its goal at which the object stands [m]. The setpoint is not enough: an
arm that stops following is noticed only after a while."""

FINGER_SHARE = 0.2
"""Share of their largest speed at which fingers move before the arm does."""

OPEN_TIME = 1.5
"""Time in which the hand opens to release the object [s]."""

LONGEST_PHASE = 30.0
"""Time on the plan's clock after which a phase has failed [s]."""

WAIT_TIME = 10.0
"""Longest wait for usable poses of the object [s]."""


def locate_object(robot: Robot, seconds: float) -> tuple[np.ndarray, RobotState]:
    """Return the average tracked pose of the resting object, world frame, shape [7], and the robot's state.

    Args:
        robot: connected.
        seconds: time in which poses are collected [s].

    Raises:
        RobotError: there is no usable pose, poses disagree, or a device does not follow.
        SafetyStop: the stop switch is pressed.
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
        # A rolling object may come to rest, and the tracker may recover.
        if robot.clock.now() > deadline:
            raise RobotError(f"{problem}: check the tracker, then start again")


def _looked(robot: Robot, seconds: float) -> tuple[np.ndarray, RobotState, str]:
    """Return the average pose over some time, the final state, and what is wrong with the poses, or ""."""
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
    """Moves a robot at the speed that was set with ``Robot.slow_down``, and records its control steps."""

    def __init__(self, robot: Robot, ticks: DeadlineMonitor):
        """robot: connected; ticks: records each control step."""
        self._robot, self._ticks = robot, ticks

    def move(self, corners: list[np.ndarray], fingers: np.ndarray) -> None:
        """Move the fingers, then the arm from posture to posture, as its path was checked with these fingers.
        corners: postures of the arm, its current one first [rad], shape [A] each; fingers: independent joints
        [rad], shape [U]."""
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
        """Lower the object, open the hand, and withdraw along the reversed approach. low: palm pose at which
        the object stands, world frame, shape [1, 7]."""
        robot, plan, period = self._robot, prepared.plan, self._robot.protocol.control_period
        robot.begin(robot.state())
        fingers = robot.setpoints.fingers.copy()
        start, step, opened = robot.now(), 0, 0.0

        def go(palm: np.ndarray, targets: np.ndarray) -> None:
            nonlocal step
            self._step(Phase.PUT_DOWN, start, step, Action(palm, targets, np.array([False])))
            step += 1

        closing = int(plan.closing_step[0])
        # The steps of the approach in reverse: fingers and palm are clear of table and object.
        back = compose(plan.object_pose, plan.palm_setpoint_object[0, : closing + 1][::-1])
        opening = np.concatenate([prepared.start_fingers[None], plan.finger_targets[0, :closing]])[::-1]
        # Keep the goal until the object stands; then open the hand.
        while opened < 1.0:
            if self.arrived(low, 0.0) and (opened or self._lowered(low)):
                opened = min(1.0, opened + period / OPEN_TIME)
            go(low, fingers + opened * (opening[:1] - fingers))
        # The palm follows its goals two steps late; fingers without this delay would open too early.
        late = [*opening[:1], *opening[:1], *opening][: len(back)]
        for pose, targets in zip(back, late, strict=True):
            go(pose[None], targets[None])
        # The move home begins at rest.
        while not self.arrived(back[-1:], 0.0) or np.abs(robot.setpoints.wrist.turning).max() > STILL:
            go(back[-1:], prepared.start_fingers[None])

    def withdraw(self, plan: GraspPlan, gap: np.ndarray) -> None:
        """Lower and release an object that is not held, and withdraw. gap: ``AttemptVerdict.gap``."""
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
        """Wait for a control step and return the time of the motion [s]. start: time of the first step [s].
        Raises: SafetyStop: the stop switch is pressed."""
        robot = self._robot
        planned = start + step * robot.control_period
        robot.sleep_until(planned)
        now = robot.now()
        self._ticks.record(planned, now)
        robot.check_switch()
        return now

    def arrived(self, goal: np.ndarray, above: float) -> bool:
        """Return whether the palm's setpoint is at a raised goal, world frame, shape [1, 7]. above: [m]."""
        apart = goal[0, :3] + np.array([0.0, 0.0, above]) - self._robot.setpoints.wrist.pose[0, :3]
        return float(np.linalg.norm(apart)) < ARRIVED

    def _lowered(self, goal: np.ndarray) -> bool:
        """Return whether the measured palm is at the height of a goal, shape [1, 7]."""
        palm = self._robot.kinematics.palm_pose(self._robot.arm.read().positions)
        return float(palm[2] - goal[0, 2]) < LOWERED

    def _step(self, phase: Phase, start: float, step: int, action: Action) -> None:
        """Make one control step."""
        self.wait_for_tick(start, step)
        self._robot.send_action(action, start + step * self._robot.control_period)
        self.check_length(phase, step)

    def check_length(self, phase: Phase, step: int) -> None:
        """Raises: SafetyStop: a phase takes longer than ``LONGEST_PHASE``."""
        if step * self._robot.protocol.control_period > LONGEST_PHASE:
            what = "grasp" if phase in (Phase.GRASP, Phase.LIFT, Phase.HOLD) else f"phase '{phase}'"
            raise SafetyStop(f"the {what} takes too long", StopKind.HOLD)
