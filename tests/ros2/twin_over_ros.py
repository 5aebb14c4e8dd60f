"""A twin on topics of ROS 2, in a process of its own: ``python twin_over_ros.py TASK``, a pickle of cell,
object and placement. It ends with its standard input, and says for how long the object was up."""

from __future__ import annotations

import pickle
import sys
import threading
import time
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from ros_joints import RosJoints

from fungrasp.hands import load_hand
from fungrasp.robots.twin.devices import RealTimeTwin
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import LiftProtocol
from fungrasp_emulators.cell import TwinArmPlant, TwinHandPlant
from fungrasp_ros2.conversions import fill, stamp_fields
from fungrasp_ros2.ros_side import RosSide


def pose_message(pose: np.ndarray, nanoseconds: int) -> PoseStamped:
    """A pose, shape [7], in the world's frame. nanoseconds: when it was captured, node's clock."""
    x, y, z, qw, qx, qy, qz = pose.tolist()
    place, turn = {"x": x, "y": y, "z": z}, {"x": qx, "y": qy, "z": qz, "w": qw}
    header = {"frame_id": "world", "stamp": stamp_fields(nanoseconds)}
    return fill(PoseStamped(), {"header": header, "pose": {"position": place, "orientation": turn}})


def main() -> None:
    """See the module."""
    # Written by the test that starts this process.
    cell, obj, placement = pickle.loads(Path(sys.argv[1]).read_bytes())
    hand, ended = load_hand(cell.hand), threading.Event()
    world = TwinWorld(cell, hand, obj, cell_twin(cell, hand, 0))
    world.settle(placement)
    rest, last, highest, up = float(world.center_of_mass()[2]), None, 0.0, 0.0
    commands = cell.hand_device.options["commands"]
    fingers = RosJoints(TwinHandPlant(world), tuple(hand.actuators), commands)
    with RealTimeTwin(world), RosJoints(TwinArmPlant(world)), fingers:
        ros = RosSide("tracker")
        publisher = ros.node.create_publisher(PoseStamped, cell.tracker.address, 1)
        print("ready", flush=True)
        threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
        before = time.monotonic()
        while not ended.wait(0.005):
            frame, now = world.tracked(), time.monotonic()
            if frame is not None and frame is not last:
                captured = ros.now - int(1e9 * (now - frame.captured))
                publisher.publish(pose_message(frame.pose_world_object, captured))
                last = frame
            lifted = world.center_of_mass()[2] - rest >= LiftProtocol.success_height
            up = up + now - before if lifted and not world.look().on_table else 0.0
            highest, before = max(highest, up), now
        print(f"{highest:.2f}", flush=True)
        ros.close()


if __name__ == "__main__":
    main()
