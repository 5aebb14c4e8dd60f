"""What stands for ur_robot_driver and for a hand's node in tests over ROS 2."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Bool, Float64, Float64MultiArray

from fungrasp.hands.arm import arm_spec
from fungrasp_emulators.emulator import Emulator, Plant, PlantCommand
from fungrasp_ros2.joint_loop import TopicSettings
from fungrasp_ros2.ros_side import RosSide

MODEL = arm_spec("ur5e").compile()
JOINTS = tuple(MODEL.joint(i).name for i in range(6))


class RosJoints(Emulator):
    """Joint states, a forward controller, and what ur_robot_driver says besides."""

    def __init__(self, plant: Plant, names: tuple[str, ...] = JOINTS, commands: str = TopicSettings.commands):
        super().__init__()
        self.plant, self.heard = plant, []
        self.scaling, self.running = 100.0, True
        self._names, self._commands = names, commands
        self._ros: RosSide | None = None

    def start(self) -> None:
        self._ended.clear()
        self._ros = ros = RosSide("ur_robot_driver")
        ros.node.create_subscription(Float64MultiArray, self._commands, self._move, 100)
        self._states = ros.node.create_publisher(JointStateMessage, TopicSettings.states, 10)
        self._speed = ros.node.create_publisher(Float64, TopicSettings.speed_scaling, 10)
        latched = ros.qos.QoSProfile(depth=1, durability=ros.qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._program = ros.node.create_publisher(Bool, TopicSettings.robot_program_running, latched)
        self._program.publish(Bool(data=self.running))
        self._run(self._serve)

    def close(self) -> None:
        self._end_threads()
        if self._ros is not None:
            self._ros.close()
            self._ros = None

    def stop_program(self) -> None:
        self._program.publish(Bool(data=False))

    def _move(self, message: Any) -> None:
        self.heard.append((time.monotonic(), list(message.data)))
        self.plant.apply(PlantCommand(positions=np.array(message.data)), time.monotonic())

    def _serve(self) -> None:
        assert self._ros is not None
        order, due = np.arange(len(self._names))[::-1], time.monotonic()
        while not self._ended.is_set():
            due = max(due, time.monotonic() - 0.01) + 0.008
            while (rest := due - time.monotonic()) > 0:
                self._ros.spin(rest)
            message, state = JointStateMessage(), self.plant.state(time.monotonic())
            message.header.stamp = self._ros.node.get_clock().now().to_msg()
            message.name = [self._names[i] for i in order]
            message.position = state.positions[order].tolist()
            message.velocity = state.velocities[order].tolist()
            self._states.publish(message)
            self._speed.publish(Float64(data=self.scaling))
