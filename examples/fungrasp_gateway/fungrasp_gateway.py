"""Driver of a hand behind a gateway that speaks lines of text (docs/robots/devices.md)."""

import contextlib
import socket
import time

import numpy as np

from fungrasp.robots.cell import RobotCell
from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError
from fungrasp.robots.hands import hand_joint_limits

PERIOD = 0.02  # [s]


class GatewayLoop:
    """Six position servos: "get" is answered by their positions [rad], "set" and six numbers moves them,
    "stop" ends motion."""

    takes_feedforward = False
    lets_go = ""
    stale_after = 0.25

    def __init__(self, hand: str, address: str, port: int):
        self.name = f"gateway at {address}:{port}"
        self.where = (address, port)
        lower, upper = hand_joint_limits(hand, 6)
        self.limits = JointLimits(lower, upper, np.full(6, 2.0), np.full(6, np.inf))
        self.connection = None
        self.before = LoopMode.IDLE

    def open(self) -> None:
        """Connect; the hand stays as it is."""
        try:
            self.connection = socket.create_connection(self.where, timeout=self.stale_after)
        except OSError as error:
            raise RobotError(f"{self.name} does not answer: {error}") from error
        self.lines = self.connection.makefile("r")

    def take_control(self) -> None:
        """The hand needs no switching on."""

    def step(self, goal: LoopGoal) -> JointState:
        """Send the goal and read the positions, every 20 ms."""
        time.sleep(PERIOD)
        if goal.mode is LoopMode.FOLLOW:
            self.say("set " + " ".join(f"{q:.5f}" for q in goal.positions))
        elif goal.mode is LoopMode.OPEN:
            self.say("set " + " ".join(f"{q:.5f}" for q in self.limits.lower))
        elif goal.mode is not self.before:
            self.halt()
        self.before = goal.mode
        self.say("get")
        try:
            positions = np.array(self.lines.readline().split(), dtype=float)
        except (OSError, ValueError) as error:
            raise RobotError(f"{self.name}: no positions: {error}") from error
        if positions.shape != (6,) or not np.isfinite(positions).all():
            raise RobotError(f"{self.name}: six positions were expected")
        now = time.monotonic()
        return JointState(positions, np.zeros(6), None, now, now, DeviceStatus.READY)

    def halt(self) -> None:
        """End motion; the servos hold by themselves. Never raises: something may be wrong already."""
        if self.before in (LoopMode.FOLLOW, LoopMode.OPEN):
            with contextlib.suppress(RobotError):
                self.say("stop")

    def close(self) -> None:
        """Close the connection."""
        if self.connection is not None:
            self.connection.close()

    def say(self, line: str) -> None:
        try:
            self.connection.sendall(line.encode() + b"\n")
        except OSError as error:
            raise RobotError(f"{self.name}: {error}") from error


def make_hand(cell: RobotCell) -> LoopDriver:
    device = cell.hand_device
    return LoopDriver(GatewayLoop(cell.hand, device.address, device.options.get("port", 5000)))
