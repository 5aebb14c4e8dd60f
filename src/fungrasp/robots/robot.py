"""A robot made of an arm, a hand and an object tracker, with the interface of policies."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.robots.cell import MotionLimits, RobotCell, plan_speed
from fungrasp.robots.device import (
    Clock,
    DeviceStatus,
    JointDriver,
    PoseSource,
    RobotCommand,
    RobotError,
    RobotState,
    SafetyStop,
    StopKind,
    TrackedPose,
    TrackingStatus,
)
from fungrasp.robots.kinematics.arm_model import ArmKinematics, ClearanceModel
from fungrasp.robots.kinematics.reach import PalmFollower
from fungrasp.robots.safety import SafetyGuard
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.sim2real.gravity_compensation import GravityCompensation, setpoint_offset
from fungrasp.task import Action, LiftProtocol, Observation
from fungrasp.task.sensors import NO_LIFT
from fungrasp.task.setpoints import SetpointGenerator, more_setpoints

_log = logging.getLogger(__name__)

LEAST_SPEED = 0.02
"""Smallest speed, as a share of the plan's: below, a grasp would take half an hour."""


class Robot:
    """Arm, hand and tracker behind the interface of a policy: observations in, actions out.

    Setpoints advance as in simulation (``fungrasp.task.setpoints``), every 20 ms. The stop switch and the
    safety filter check each setpoint, and either stops the robot. Call all methods from one thread.
    """

    def __init__(
        self,
        cell: RobotCell,
        hand: Hand,
        arm: JointDriver,
        hand_driver: JointDriver,
        tracker: PoseSource,
        clock: Clock,
        *,
        stiffness: np.ndarray | None = None,
        compensate: bool = True,
        switch: StopSwitch | None = None,
    ):
        """
        Args:
            stiffness: identified stiffness of the hand's servos [N m/rad], shape [U]; the model's if None.
            compensate: whether to compensate the weight of the hand's links.
            switch: stop switch; None: one that watches the cell's stop file.
        """
        self.cell, self.hand, self.clock = cell, hand, clock
        self.arm, self.hand_driver, self.tracker = arm, hand_driver, tracker
        self.compensate = compensate
        self.kinematics = ArmKinematics(cell, hand)
        self.protocol = _protocol(cell.limits)
        """Limits of the palm's motion, and parameters of the task."""
        self._servo_limits = np.stack([hand_driver.limits.lower, hand_driver.limits.upper], axis=1)
        self.setpoints = SetpointGenerator(self._servo_limits, 1, self.protocol)
        self.switch = StopSwitch(cell.stop_file) if switch is None else switch
        """Stop switch."""
        self.guard = SafetyGuard(
            cell,
            {"arm": arm.limits, "hand": hand_driver.limits},
            ClearanceModel(cell, hand).measure,
            self.setpoints.period,
            palm=self.kinematics.palm_pose,
        )
        """Safety filter of all commands."""
        self.watch: Callable[[RobotState, RobotCommand], None] = lambda state, command: None
        """Called after each command that was sent, to record it."""
        self.due: Callable[[float], object] = lambda planned: None
        """Called when a setpoint is due, with its planned time on the robot's clock [s]."""
        self._follower: PalmFollower | None = None
        self._gravity = GravityCompensation(hand)
        servos = np.array([servo.kp for servo in hand.actuators.values()])
        self._stiffness = servos if stiffness is None else stiffness
        self._seen: TrackedPose | None = None
        self._began = self._paused = 0.0
        self._next, self._planned = -np.inf, np.inf
        self._count = self.setpoints.number
        self.leg_speed = 1.0
        """Speed of the arm from posture to posture, as a share of the cell's limits."""
        self.lift_time = np.inf
        """Start of the lift, on the plan's clock [s]; infinite before."""
        self.lift_height = 0.0
        """Rise of the palm's goals once the lift has begun [m]."""

    def connect(self) -> None:
        """Connect to all devices, and warn if the hand may let go on its own. Nothing moves. Raises:
        RobotError: a device is missing or not the configured one; the others are closed again."""
        if self.hand_driver.lets_go:
            _log.warning("%s lets go of an object %s", self.hand_driver.name, self.hand_driver.lets_go)
        opened: list[JointDriver | PoseSource] = []
        try:
            for device in (self.arm, self.hand_driver, self.tracker):
                device.connect()
                opened.append(device)
        except FungraspError:
            for device in reversed(opened):
                device.close()
            raise

    def take_control(self) -> None:
        """Make arm and hand ready to follow, which may take seconds. Raises: RobotError: one of them can't be
        controlled now."""
        self.arm.take_control()
        self.hand_driver.take_control()

    def close(self) -> None:
        """Stop and end all connections, even if one of them fails. May be called twice."""
        with ExitStack() as last_first:
            for device in (self.tracker, self.hand_driver, self.arm):
                last_first.callback(device.close)

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        """End motion: the arm brakes and holds, the hand stops as given. Never raises."""
        for device, how in ((self.arm, StopKind.HOLD), (self.hand_driver, kind)):
            try:
                device.stop(how)
            except Exception:
                # Drivers of other packages may raise: stop the other device all the same.
                _log.exception("%s does not stop", device.name)

    def state(self) -> RobotState:
        """Return the latest states of all devices, without waiting."""
        seen = self.tracker.read()
        if seen is not None and seen.status is TrackingStatus.TRACKING:
            self._seen = seen
        return RobotState(self.clock.now(), self.arm.read(), self.hand_driver.read(), self._seen)

    def now(self) -> float:
        """Return the time of the motion [s]: the robot's clock without delays that are not made up for."""
        return self.clock.now() - self._paused

    def begin(self, state: RobotState, lift_height: float = 0.0) -> float:
        """Begin a plan: its clock starts at zero. lift_height: rise of the palm's goals once an action lifts
        [m]. Returns: start of the plan, time of the motion [s]."""
        self._began = state.time - self._paused
        self.lift_time, self.lift_height = np.inf, lift_height
        return self._began

    def place_setpoints(self, arm: np.ndarray, fingers: np.ndarray) -> None:
        """Set the setpoints to a posture at rest, after a motion in joint space. arm: joints of the arm
        [rad], shape [A]; fingers: independent joints of the hand [rad], shape [U]."""
        if self._follower is None:
            self._follower = PalmFollower(self.kinematics, self.cell.limits.arm_speed)
        self._follower.begin(arm)
        self.guard.reset()
        palm = self.kinematics.palm_pose(arm)[None]
        self.setpoints.begin(np.array([0]), palm, np.zeros((1, 3)), fingers[None])

    @property
    def palm_follower_joints(self) -> np.ndarray:
        """Last setpoint of the arm's joints for the palm [rad], shape [A]."""
        assert self._follower is not None, "place_setpoints() comes first"
        return self._follower.joints

    def slow_down(self, speed: float) -> None:
        """Slow plans down from now on, at least as far as the cell's limits require, by more setpoints at the
        same rate. The silence of devices and the age of poses stay on the robot's clock.

        Args:
            speed: share of the plans' speed, ``LEAST_SPEED`` to 1. It may become a little smaller, as a
                control period is rounded up to whole setpoint periods.

        Raises:
            FungraspError: the speed is out of range.
        """
        if not LEAST_SPEED <= speed <= 1.0:
            raise FungraspError(f"the speed is a share of the plan's, {LEAST_SPEED:g} to 1, not {speed:g}")
        allowed = plan_speed(self.cell.limits)
        self.leg_speed = min(1.0, speed / allowed)
        # Setpoints have the speed of the plan, and are stretched afterwards.
        self.protocol = _protocol(MotionLimits())
        self.setpoints = SetpointGenerator(self._servo_limits, 1, self.protocol)
        self._count = int(np.ceil(self.setpoints.number / min(speed, allowed) - 1e-9))

    @property
    def speed(self) -> float:
        """Speed of the plan's clock relative to the robot's clock, 1 unless it is slowed down."""
        return self.setpoints.number / self._count

    @property
    def control_period(self) -> float:
        """Time between two actions, on the robot's clock [s]."""
        return self._count * self.setpoints.period

    def plan_time(self, time: float) -> float:
        """Return the time since the plan began, on the plan's clock [s]. time: on the robot's clock [s]."""
        return (time - self._paused - self._began) * self.speed

    def stand_still(self, seconds: float) -> None:
        """Stop the plan's clock for a time in which the robot stood still [s]."""
        self._began += seconds

    def get_observation(self) -> Observation:
        """Read the sensors and return the observation for a policy, one row. Raises: RobotError: the tracker
        has not seen the object yet."""
        return self.observation(self.state())

    def observation(self, state: RobotState) -> Observation:
        """Return the observation of a state. See ``get_observation``."""
        if state.tracked is None:
            raise RobotError(f"{self.tracker.name} has not seen the object yet: look where the camera points")
        time = self.plan_time(state.time)
        return Observation(
            time=np.array([time]),
            time_since_lift=np.array([max(time - self.lift_time, NO_LIFT)]),
            joint_positions=state.hand.positions[None].copy(),
            joint_setpoints=self.setpoints.fingers.copy(),
            palm_pose=self.kinematics.palm_pose(state.arm.positions)[None],
            palm_setpoint=self.setpoints.wrist.pose.copy(),
            object_pose=state.tracked.pose_world_object[None].copy(),
            object_pose_age=np.array([state.time - state.tracked.captured]),
        )

    def send_action(self, action: Action, start: float | None = None) -> Action:
        """Carry out an action: five setpoints, 20 ms apart, or more if the robot is slowed down. Returns
        after the last one, 80 ms after the first at full speed.

        Args:
            start: start of the control period, time of the motion [s]; if None, now or a setpoint period
                after the last setpoint.

        Returns:
            action as sent: last setpoints of palm and fingers, and whether the lift has begun.

        Raises:
            SafetyStop: the safety filter or the switch stopped the robot.
            RobotError: a device no longer follows, or a value is not finite.
        """
        if not all(np.isfinite(v).all() for v in (action.palm_goal_world, action.finger_targets)):
            raise RobotError("the policy's action is not finite: its file may be damaged")
        start = max(self.now(), self._next) if start is None else start
        if action.lift[0] and not np.isfinite(self.lift_time):
            self.lift_time = self.plan_time(start + self._paused)
        goal = action.palm_goal_world.copy()
        goal[:, 2] += self.lift_height * np.isfinite(self.lift_time)
        palm, joints = self.setpoints.wrist.pose[0].copy(), self.setpoints.fingers[0].copy()
        sequence = self.setpoints.advance(goal, action.finger_targets)
        palms, fingers = sequence.palm[:, 0], sequence.fingers[:, 0]
        if self._count > len(palms):
            palms, fingers = more_setpoints(palm, palms, joints, fingers, self._count)
        assert self._follower is not None, "begin() comes first"
        sent = None
        for i in range(len(palms)):
            self.wait(start + i * self.setpoints.period)
            joints, place, turn = self._follower.follow(palms[i], self.setpoints.period)
            if place > 0.02 or turn > 0.1:
                self.stop()
                raise SafetyStop("the arm can't reach the palm's setpoint", StopKind.HOLD)
            sent = self.send(joints, fingers[i])
        assert sent is not None
        return replace(
            action,
            palm_goal_world=sent.palm[None],
            finger_targets=sent.hand[None],
            lift=np.array([np.isfinite(self.lift_time)]),
        )

    def sleep_until(self, when: float) -> None:
        """Wait until a time of the motion [s]; return at once if it has passed."""
        self.clock.sleep_until(when + self._paused)

    def wait(self, when: float) -> None:
        """Wait until a setpoint is due. A delay beyond ``watchdog.late_tick`` is not made up for: later
        setpoints shift by it. when: time of the motion [s]. Raises: SafetyStop: the delay is beyond
        ``watchdog.overrun``; the robot was stopped."""
        dog = self.cell.watchdog
        self.sleep_until(when)
        self.due(when + self._paused)
        late = self.now() - when
        if late > dog.overrun:
            self.stop()
            raise SafetyStop(f"the control period was overrun by {1e3 * late:.0f} ms", StopKind.HOLD)
        self._planned, self._next = when, when + self.setpoints.period

    def send(self, arm: np.ndarray, fingers: np.ndarray) -> RobotCommand:
        """Send one setpoint to all servos.

        Args:
            arm: joints of the arm [rad], shape [A].
            fingers: independent joints of the hand [rad], shape [U].

        Returns:
            the command as sent.

        Raises:
            SafetyStop: the safety filter or the switch stopped the robot.
            RobotError: a device no longer follows; the robot was stopped.
        """
        try:
            return self._send(arm, fingers)
        except SafetyStop as stop:
            self.stop(stop.kind)
            raise
        except RobotError:
            self.stop()
            raise

    def check_switch(self) -> None:
        """Raises: SafetyStop: the stop switch is pressed."""
        if self.switch.reason:
            raise SafetyStop(self.switch.reason, StopKind.HOLD)

    def _send(self, arm: np.ndarray, fingers: np.ndarray) -> RobotCommand:
        self.check_switch()
        state = self.state()
        palm = self.kinematics.palm_pose(arm)
        torques = np.zeros(len(fingers))
        if self.compensate:
            rotation = self.kinematics.palm_pose(state.arm.positions)[3:]
            torques = self._gravity.torques(rotation, state.hand.positions)
        command = RobotCommand(arm, fingers, torques, palm)
        command = self.guard(state, command)
        self._paused += max(min(self.guard.lost, state.time - self._paused - self._planned), 0.0)
        self._planned = np.inf
        sent_arm = self.arm.command(command.arm)
        if self.hand_driver.takes_feedforward:
            sent_hand = self.hand_driver.command(command.hand, command.feedforward)
        else:
            offset = setpoint_offset(command.feedforward, self._stiffness)
            sent_hand = self.hand_driver.command(command.hand + offset) - offset
        command = replace(command, arm=sent_arm, hand=sent_hand)
        self.watch(state, command)
        return command

    @property
    def ready(self) -> bool:
        """Whether both arm and hand follow commands."""
        return all(d.read().status is DeviceStatus.READY for d in (self.arm, self.hand_driver))


def _protocol(limits: MotionLimits) -> LiftProtocol:
    return LiftProtocol(
        wrist_speed=limits.palm_speed,
        wrist_acceleration=limits.palm_acceleration,
        wrist_rotation_speed=limits.palm_rotation_speed,
        wrist_rotation_acceleration=limits.palm_rotation_acceleration,
    )
