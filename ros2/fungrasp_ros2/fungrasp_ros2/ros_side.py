"""A node of ROS with a context of its own, in a thread or a loop: what needs rclpy goes through here."""

from __future__ import annotations

import contextlib
import importlib
import threading
from collections.abc import Callable
from types import ModuleType
from typing import Any

from fungrasp.robots.device import RobotError


def ros_module(name: str) -> ModuleType:
    """A module of ROS.

    Raises:
        RobotError: it is not there.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise RobotError(
            f"'{name}' can't be imported ({error}): source the setup of ROS 2, and of the workspace"
        ) from error


class RosSide:
    """A node. Not shared: each device has its own, as each may run in a process of its own."""

    def __init__(self, name: str):
        """
        Args:
            name: of the node.

        Raises:
            RobotError: there is no ROS.
        """
        rclpy, executors = ros_module("rclpy"), ros_module("rclpy.executors")
        self.qos = ros_module("rclpy.qos")
        """Of rclpy."""
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node(name, context=self._context)
        """The node."""
        self._executor = executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def now(self) -> int:
        """Of the node's clock [ns]."""
        return self.node.get_clock().now().nanoseconds

    def newest(self, kind: type, topic: str, heard: Callable[[Any], None]) -> None:
        """Call back with messages of a stream; where we are late, the oldest are lost. kind: of the messages.

        Not the newest only: several publishers may share a topic, as of joint states.
        """
        profile = self.qos.QoSProfile(depth=10, reliability=self.qos.ReliabilityPolicy.BEST_EFFORT)
        self.node.create_subscription(kind, topic, heard, profile)

    def latched(self, kind: type, topic: str, heard: Callable[[Any], None]) -> None:
        """Call back with messages that are sent when something changes: also with the last one before now,
        where the publisher keeps it. kind: of the messages."""
        for durability in ("TRANSIENT_LOCAL", "VOLATILE"):
            # A publisher that keeps nothing does not talk to a subscription that asks for it.
            profile = self.qos.QoSProfile(depth=1, durability=getattr(self.qos.DurabilityPolicy, durability))
            self.node.create_subscription(kind, topic, heard, profile)

    def spin(self, seconds: float) -> None:
        """Take what has come, at most one message, and wait for it at most so long [s]."""
        self._executor.spin_once(timeout_sec=max(seconds, 0.0))

    def spin_in_thread(self) -> None:
        """Take whatever comes from now on."""

        def run() -> None:
            while not self._ended.is_set():
                self.spin(0.1)

        self._thread = threading.Thread(target=run, daemon=True, name=self.node.get_name())
        self._thread.start()

    def close(self) -> None:
        """End the node. Never raises."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(1.0)
        with contextlib.suppress(Exception):
            self._executor.shutdown()
            self.node.destroy_node()
            self._context.shutdown()
