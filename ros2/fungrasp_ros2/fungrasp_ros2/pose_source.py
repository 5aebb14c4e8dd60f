"""The pose of an object from ROS: messages geometry_msgs/PoseStamped, or a frame that tf knows."""

from __future__ import annotations

import time
from typing import Any, Self

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.geometry.poses import compose
from fungrasp.robots.cell import RobotCell, check_calibrated
from fungrasp.robots.device import RobotError, TrackedPose, TrackingStatus
from fungrasp_ros2.conversions import captured_time, pose_of
from fungrasp_ros2.ros_side import RosSide, ros_module

TF = "tf:"
"""Beginning of an address that names a frame."""
OPTIONS = ("world_frame", "camera_frame", "score", "timeout")


def make_pose_source(cell: RobotCell) -> RosPoseSource:
    """Entry point ``fungrasp.pose_sources``: the tracker of a cell. Its address is a topic, or "tf:" and the
    object's frame; options: ``world_frame`` ("world"), ``camera_frame`` (""), ``score`` (1.0), ``timeout``.
    """
    options = dict(cell.tracker.options)
    for name in options:
        if name not in OPTIONS:
            raise UnknownNameError("option of the driver ros2", name, OPTIONS)
    if not cell.tracker.address:
        raise FungraspError('\'address\' is missing: a topic ("/object_pose"), or "tf:" and a frame')
    camera = None
    if options.get("camera_frame"):
        check_calibrated(cell)
        camera = np.array(cell.tracker.pose_world_camera)
    return RosPoseSource(cell.tracker.address, pose_world_camera=camera, **options)


class RosPoseSource:
    """``PoseSource`` on a topic or on tf. A message that can't be used is ignored, so that the pose before it
    grows old."""

    def __init__(
        self,
        address: str,
        world_frame: str = "world",
        camera_frame: str = "",
        score: float = 1.0,
        timeout: float = 3.0,
        pose_world_camera: np.ndarray | None = None,
    ):
        """
        Args:
            address: a topic, or "tf:" and a frame.
            world_frame: name of the cell's world in ROS.
            camera_frame: name of the camera's optical frame; poses in it go by the cell's calibration.
            score: confidence that is reported: the messages hold none, 0 to 1.
            timeout: to wait for the first pose on connecting [s].
            pose_world_camera: where the camera is, shape [7]; of ``camera_frame``.
        """
        self.name = f"ROS poses on {address}"
        self.ignored = ""
        """Why the last message that could not be used was not."""
        self._address, self._world, self._camera = address, world_frame, camera_frame
        self._score, self._timeout, self._pose_world_camera = score, timeout, pose_world_camera
        self._ros: RosSide | None = None
        self._buffer: Any = None
        self._listener: Any = None
        self._last: TrackedPose | None = None

    def connect(self) -> None:
        self.close()
        self._last, self.ignored = None, ""
        self._ros = RosSide("fungrasp_pose")
        if self._address.startswith(TF):
            self._listen_to_tf()
        else:
            kind = ros_module("geometry_msgs.msg").PoseStamped
            self._ros.newest(kind, self._address, self._hear)
        self._ros.spin_in_thread()
        deadline = time.monotonic() + self._timeout
        while self.read() is None:
            if time.monotonic() > deadline:
                why = self.ignored or f"nothing came within {self._timeout:g} s; is the tracker running?"
                self.close()
                raise RobotError(f"{self.name}: {why}")
            time.sleep(0.01)

    def read(self) -> TrackedPose | None:
        if self._address.startswith(TF) and self._ros is not None:
            self._look_up()
        return self._last

    def close(self) -> None:
        if self._ros is not None:
            self._ros.close()
            self._ros = self._buffer = self._listener = None

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _listen_to_tf(self) -> None:
        assert self._ros is not None
        tf2 = ros_module("tf2_ros")
        self._buffer = tf2.Buffer()
        self._listener = tf2.TransformListener(self._buffer, self._ros.node)

    def _hear(self, message: Any) -> None:
        try:
            self._take(message.header, pose_of(message.pose))
        except RobotError as error:
            self.ignored = str(error)

    def _look_up(self) -> None:
        frame = self._address[len(TF) :]
        try:
            found = self._buffer.lookup_transform(self._world, frame, ros_module("rclpy.time").Time())
            self._take(found.header, pose_of(found.transform))
        except RobotError as error:
            self.ignored = str(error)
        except Exception as error:
            # tf2 has an exception for each way in which a frame is not known.
            self.ignored = f"tf has no way from '{self._world}' to '{frame}': {' '.join(str(error).split())}"

    def _take(self, header: Any, pose: np.ndarray) -> None:
        assert self._ros is not None
        captured = captured_time(header.stamp, self._ros.now, time.monotonic())
        if header.frame_id == self._camera and self._pose_world_camera is not None:
            pose = compose(self._pose_world_camera, pose)
        elif header.frame_id != self._world:
            known = f"'{self._world}'" + f" or '{self._camera}'" * bool(self._camera)
            raise RobotError(
                f"poses are in the frame '{header.frame_id}', not {known}: give its name as 'world_frame' or "
                f"'camera_frame', or publish tf and give the address '{TF}' with the object's frame"
            )
        self._last = TrackedPose(pose, captured, self._score, TrackingStatus.TRACKING)
