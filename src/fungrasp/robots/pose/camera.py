"""Poses of a known object from a depth camera's images, by ``fungrasp.perception``: searched for once, then
followed from image to image in a thread of its own."""

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
"""Longest wait for a frame before it is looked whether to end [s]."""

LOST_FRAMES = 10
"""After so many images in a row without the object it is searched for again."""

_log = logging.getLogger(__name__)


class CameraTracker(PoseSource):
    """Of a camera that stands still."""

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
            pose_world_camera: where the camera stands, shape [7], from calibration.
            start: where the object is at first, world frame, shape [7]; searched for if None, which takes a
                second or two.
        """
        self.name = f"tracker of '{obj.name}' in images of {frames.name}"
        self.seconds: list[float] = []
        """Processor time of each image that was followed [s]."""
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
                # Poses grow old, which stops the robot; the reason is in the log.
                _log.error("%s has ended: %s", self.name, error)
                return

    def _answer(self, frame: CameraFrame) -> TrackedPose | None:
        """What an image says."""
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
        """The first pose: given or searched for; what was said last where the object is not there."""
        pose, score = self._start, 1.0
        if pose is None:
            found = estimate_object_pose(frame.capture(), self._object, seed=self._seed)
            if not found.accepted:
                return self._newest
            pose, score = found.pose_camera_object, found.score
        self._tracker = ObjectTracker(self._object, frame.intrinsics, pose, seed=self._seed)
        # The search took a second, in which the object may have moved: the next image says where it is.
        world = compose(self._camera, pose)
        return TrackedPose(world, frame.time, score, TrackingStatus.INITIALIZING)
