"""Object tracking in images of a depth camera, by ``fungrasp.perception``, in a thread."""

from __future__ import annotations

import logging
import threading
import time
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, invert
from fungrasp.objects import ObjectModel
from fungrasp.perception.object_pose.estimate import estimate_object_pose
from fungrasp.perception.object_pose.tracker import FOLLOWED, ObjectTracker
from fungrasp.robots.device import PoseSource, RobotError, TrackedPose, TrackingStatus

if TYPE_CHECKING:
    from fungrasp.perception.io.capture import CameraFrame
    from fungrasp.perception.io.realsense import RealSenseCamera

WAIT = 0.2
"""Longest wait for a frame before the thread checks whether to end [s]."""

LOST_FRAMES = 10
"""Number of consecutive images without the object after which it is detected again."""

_log = logging.getLogger(__name__)


class CameraTracker(PoseSource):
    """Tracks an object with a fixed camera: detects it once, then follows it from image to image."""

    def __init__(
        self,
        frames: RealSenseCamera,
        obj: ObjectModel,
        pose_world_camera: np.ndarray,
        *,
        start: np.ndarray | None = None,
        seed: int = 0,
    ):
        """
        Args:
            pose_world_camera: calibrated pose of the camera, world frame, shape [7].
            start: initial pose of the object, world frame, shape [7]; if None, it is detected, which takes a
                second or two.
        """
        self.name = f"tracker of '{obj.name}' in images of {frames.name}"
        self.seconds: list[float] = []
        """Processor time of tracking for each image [s]."""
        self._frames, self._object, self._camera = frames, obj, np.asarray(pose_world_camera, dtype=float)
        self._start = None if start is None else compose(invert(self._camera), np.asarray(start))
        self._seed = seed
        self._tracker: ObjectTracker | None = None
        self._missed = 0
        self._newest: TrackedPose | None = None
        self._thread: threading.Thread | None = None
        self._end = threading.Event()

    def connect(self) -> None:
        if self._thread is not None:
            raise RobotError(f"{self.name} is connected already")
        try:
            self._frames.__enter__()
        except FungraspError as error:
            raise RobotError(str(error)) from error
        self._tracker, self._missed, self._newest = None, 0, None
        self._end.clear()
        self._thread = threading.Thread(target=self._run, name="object tracker", daemon=True)
        self._thread.start()

    def read(self) -> TrackedPose | None:
        return self._newest

    def close(self) -> None:
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._frames.__exit__()

    def _run(self) -> None:
        while not self._end.is_set():
            try:
                frame = self._frames.newest(WAIT)
                if frame is not None:
                    self._newest = self._answer(frame)
            except (FungraspError, RuntimeError) as error:
                # The last pose grows old, which stops the robot.
                _log.error("%s has ended: %s", self.name, error)
                return

    def _answer(self, frame: CameraFrame) -> TrackedPose | None:
        """Return the pose from an image."""
        if self._tracker is None:
            return self._found(frame)
        began = time.thread_time()
        track = self._tracker.update(frame.color, frame.depth)
        self.seconds.append(time.thread_time() - began)
        followed = track.score >= FOLLOWED
        self._missed = 0 if followed else self._missed + 1
        if self._missed >= LOST_FRAMES:
            self._tracker, self._start, self._missed = None, None, 0
        status = TrackingStatus.TRACKING if followed else TrackingStatus.LOST
        return TrackedPose(compose(self._camera, track.pose), frame.time, track.score, status)

    def _found(self, frame: CameraFrame) -> TrackedPose | None:
        """Return the first pose, given or detected; the previous pose if the object is not found."""
        pose, score = self._start, 1.0
        if pose is None:
            found = estimate_object_pose(frame.capture(), self._object, seed=self._seed)
            if not found.accepted:
                return self._newest
            pose, score = found.pose_camera_object, found.score
        self._tracker = ObjectTracker(self._object, frame.intrinsics, pose, seed=self._seed)
        # The object may have moved during the detection, which takes a second: the next image tells.
        world = compose(self._camera, pose)
        return TrackedPose(world, frame.time, score, TrackingStatus.INITIALIZING)
