"""Drivers of arms and hands whose joints are led over topics: joint states in, positions out.

An arm is behind ros2_control's ``forward_position_controller`` (ur_robot_driver brings it), which passes
positions on as they come. So the path between goals is made here, at ``rate``. Where this process dies, the
controller keeps the last setpoint: the arm stops where it was told to be last.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands import load_hand
from fungrasp.hands.arm import arm_spec
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import JointLimits, JointState, RobotError
from fungrasp.robots.hands import hand_joint_limits
from fungrasp_ros2.arm_watch import ArmWatch
from fungrasp_ros2.conversions import command_fields, fill, joints_of
from fungrasp_ros2.ros_side import RosSide, ros_module
from fungrasp_ros2.smooth_path import SmoothPath

WATCHED = ("safety_mode", "robot_program_running", "speed_scaling")
OPEN_SPEED = 0.5
"""Of a hand that opens after a fault [rad/s]."""
BRAKING = 2.0
"""Longest time in which motion is ended on closing [s]."""


@dataclass(frozen=True)
class TopicSettings:
    """Topics and limits of joints that are led over ROS; options of a cell."""

    states: str = "/joint_states"
    """sensor_msgs/JointState, with other joints or without."""
    commands: str = "/forward_position_controller/commands"
    """std_msgs/Float64MultiArray, in the order of ``joints``."""
    joints: tuple[str, ...] = ()
    """Names in the joint states, in the order of the model; empty: the model's own names."""
    prefix: str = ""
    """Before each of the model's own names (``tf_prefix`` of ur_robot_driver)."""
    safety_mode: str = "/io_and_status_controller/safety_mode"
    """ur_dashboard_msgs/SafetyMode; "" leaves it unwatched."""
    robot_program_running: str = "/io_and_status_controller/robot_program_running"
    """std_msgs/Bool; "" leaves it unwatched."""
    speed_scaling: str = "/speed_scaling_state_broadcaster/speed_scaling"
    """std_msgs/Float64 [percent]; "" leaves it unwatched."""
    rate: float = 125.0
    """Of the setpoints [Hz]."""
    velocity: float = 1.0
    """Highest speed of each joint [rad/s]."""
    acceleration: float = 2.5
    """Highest acceleration of each joint [rad/s^2]."""
    jerk: float = 50.0
    """Highest jerk of each joint [rad/s^3]."""
    stale_after: float = 0.1
    """Joint states older than this are a lost connection [s]."""
    timeout: float = 3.0
    """To wait for the first messages on connecting [s]."""

    def __post_init__(self) -> None:
        for name in ("rate", "velocity", "acceleration", "jerk", "stale_after", "timeout"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise RobotError(f"the option '{name}' must be a positive number, not {value!r}")


def make_arm(cell: RobotCell) -> LoopDriver:
    """Entry point ``fungrasp.arm_drivers``: the arm of a cell; its address is the name of the node."""
    model = arm_spec(cell.arm.model).compile()
    names = tuple(model.joint(i).name for i in range(model.njnt))
    settings = _settings(cell.arm.options)
    count = len(names)
    lower, upper = model.jnt_range.T.copy()
    limits = JointLimits(lower, upper, np.full(count, settings.velocity), np.full(count, np.inf))
    return LoopDriver(JointTopicLoop(cell.arm.address, settings, names, limits))


def make_hand(cell: RobotCell) -> LoopDriver:
    """Entry point ``fungrasp.hand_drivers``: a cell's hand, without the topics of an arm's controller."""
    given = dict(cell.hand_device.options)
    if not given.get("commands"):
        raise FungraspError("the option 'commands' is missing: the topic that moves the hand")
    hand = load_hand(cell.hand)
    names = tuple(hand.actuators)
    unwatched = dict.fromkeys(WATCHED, "")
    settings = _settings({"velocity": 4.0, "acceleration": 40.0, "jerk": 2000.0} | given | unwatched)
    lower, upper = hand_joint_limits(cell.hand, len(names))
    limits = JointLimits(lower, upper, np.full(len(names), settings.velocity), np.full(len(names), np.inf))
    return LoopDriver(JointTopicLoop(cell.hand_device.address, settings, names, limits, opens=True))


class JointTopicLoop:
    """``DeviceLoop`` of joints behind topics."""

    def __init__(
        self,
        name: str,
        settings: TopicSettings,
        names: tuple[str, ...],
        limits: JointLimits,
        opens: bool = False,
    ):
        """
        Args:
            name: of the node.
            settings: topics and limits.
            names: of the joints by the model.
            limits: what is accepted.
            opens: whether it is a hand, whose zeros are open.

        Raises:
            RobotError: another number of names than of joints.
        """
        self.settings, self.limits = settings, limits
        self.joints = settings.joints or tuple(f"{settings.prefix}{joint}" for joint in names)
        if len(self.joints) != len(names):
            raise RobotError(f"'joints' names {len(self.joints)}, and the model has {len(names)}: {names}")
        self.name = f"ROS joints on {settings.commands}"
        self.stale_after = settings.stale_after
        self.takes_feedforward = False
        self.lets_go = ""
        self._opens, self._node = opens, name or "fungrasp_joints"
        watched = frozenset(topic for topic in WATCHED if getattr(settings, topic))
        self._watch = ArmWatch(len(names), settings.stale_after, watched)
        self._ros: RosSide | None = None
        self._publisher: Any = None
        self._path: SmoothPath | None = None
        self._taken, self._due = False, 0.0
        self._last: JointState | None = None

    def open(self) -> None:
        """See ``DeviceLoop.open``: listens only."""
        s = self.settings
        sensor, std = ros_module("sensor_msgs.msg"), ros_module("std_msgs.msg")
        self._ros = ros = RosSide(self._node)
        ros.newest(sensor.JointState, s.states, self._hear_joints)
        if s.safety_mode:
            kind = ros_module("ur_dashboard_msgs.msg").SafetyMode
            ros.latched(kind, s.safety_mode, lambda m: setattr(self._watch, "safety_mode", m.mode))
        if s.robot_program_running:
            topic = s.robot_program_running
            ros.latched(std.Bool, topic, lambda m: setattr(self._watch, "program_running", m.data))
        if s.speed_scaling:
            ros.newest(std.Float64, s.speed_scaling, lambda m: setattr(self._watch, "speed_scaling", m.data))
        self._publisher = ros.node.create_publisher(std.Float64MultiArray, s.commands, 1)
        deadline = time.monotonic() + s.timeout
        while not len(self._watch.positions):
            if time.monotonic() > deadline:
                words = self._watch.fault or f"nothing came within {s.timeout:g} s; is its driver running?"
                raise RobotError(f"{self.name}: no joint states on {s.states}: {words}")
            ros.spin(0.05)
        self._due = time.monotonic()

    def take_control(self) -> None:
        """See ``DeviceLoop.take_control``: nothing is sent before the first goal."""
        assert self._ros is not None, "open() comes first"
        deadline = time.monotonic() + self.settings.timeout
        while why := self._why_not():
            if time.monotonic() > deadline:
                raise RobotError(f"{self.name}: {why}")
            self._ros.spin(0.02)
        self._path, self._taken = None, True

    def step(self, goal: LoopGoal) -> JointState:
        assert self._ros is not None, "open() comes first"
        self._due = max(self._due, time.monotonic() - 1 / self.settings.rate) + 1 / self.settings.rate
        while (rest := self._due - time.monotonic()) > 0:
            self._ros.spin(rest)
        state = self._watch.state(time.monotonic(), self._taken)
        last = self._last
        if last is None or (state.device_time, state.status, state.message) != (
            last.device_time,
            last.status,
            last.message,
        ):
            self._last = last = state
        if self._taken:
            self._lead(goal)
        if goal.mode is LoopMode.IDLE:
            self._taken = False
        return last

    def halt(self) -> None:
        """See ``DeviceLoop.halt``: setpoints brake, then the controller keeps the last one."""
        with contextlib.suppress(Exception):
            deadline = time.monotonic() + BRAKING
            while self._path is not None and not self._path.resting and time.monotonic() < deadline:
                self._publish(self._path.brake())
                time.sleep(1 / self.settings.rate)

    def close(self) -> None:
        if self._ros is not None:
            self._ros.close()

    def _hear_joints(self, message: Any) -> None:
        if not set(self.joints) & set(message.name):
            # Of other joints: topics of joint states have several publishers.
            return
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        try:
            positions, velocities = joints_of(message, self.joints)
        except RobotError as error:
            self._watch.fault = str(error)
            return
        self._watch.hear_joints(positions, velocities, stamp, time.monotonic())

    def _why_not(self) -> str:
        if self._publisher.get_subscription_count() == 0:
            return (
                f"nobody listens on {self.settings.commands}: activate its controller, as by 'ros2 control "
                "switch_controllers --deactivate scaled_joint_trajectory_controller --activate "
                "forward_position_controller'"
            )
        return self._watch.why_not()

    def _lead(self, goal: LoopGoal) -> None:
        if self._path is None:
            if goal.mode not in (LoopMode.FOLLOW, LoopMode.OPEN):
                return
            s = self.settings
            start = np.clip(self._watch.positions, self.limits.lower, self.limits.upper)
            self._path = SmoothPath(start, 1 / s.rate, s.velocity, s.acceleration, s.jerk)
        if goal.mode is LoopMode.FOLLOW:
            self._publish(self._path.follow(goal.positions))
        elif goal.mode is LoopMode.OPEN and self._opens:
            opened = np.clip(np.zeros(len(self.joints)), self.limits.lower, self.limits.upper)
            self._publish(self._path.follow(opened, OPEN_SPEED))
        else:
            self._publish(self._path.brake())

    def _publish(self, positions: np.ndarray) -> None:
        kind = ros_module("std_msgs.msg").Float64MultiArray
        self._publisher.publish(fill(kind(), command_fields(positions)))


def _settings(options: Mapping[str, Any]) -> TopicSettings:
    known = [f.name for f in fields(TopicSettings)]
    for name in options:
        if name not in known:
            raise UnknownNameError("option of the driver ros2", name, known)
    given: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in options.items()}
    return TopicSettings(**given)
