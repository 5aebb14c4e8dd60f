"""Poses of a known object from a depth camera's images, by ``fungrasp.perception``: searched for once, then
followed from image to image in a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, invert
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture
from fungrasp.perception.io.realsense import RealSenseCamera, StreamSettings
from fungrasp.perception.object_pose.estimate import estimate_object_pose
from fungrasp.perception.object_pose.tracker import FOLLOWED, ObjectTracker
from fungrasp.robots.device import PoseSource, RobotError, TrackedPose, TrackingStatus


@dataclass(frozen=True, eq=False)
class Frame:
    """Color with aligned depth."""

    capture: Capture
    """The images."""
    captured: float
    """Host time at which they were taken [s]."""


class FrameSource(Protocol):
    """A depth camera."""

    name: str
    """Type and address, for messages and logs."""

    def connect(self) -> None:
        """Open the camera. Raises: RobotError: there is none."""
        ...

    def newest(self, timeout: float) -> Frame | None:
        """The newest frame that was not given yet; waits for it. None if none comes in time, or the last one
        was given.

        Args:
            timeout: to wait [s].
        """
        ...

    def close(self) -> None:
        """Close it. May be called twice."""
        ...


class RealSenseFrames(FrameSource):
    """A RealSense camera (extra ``realsense``), by ``RealSenseCamera``: a frame counts as taken when its own
    time stamp says so, or as it arrives where that is of another clock."""

    def __init__(self, serial: str = "", width: int = 640, height: int = 480, rate: int = 30):
        """
        Args:
            serial: number of the camera; "" for the first that is connected.
            width: of the images [pixels].
            height: of the images [pixels].
            rate: [1/s].
        """
        self._camera = RealSenseCamera(serial=serial, stream=StreamSettings(width, height, rate))
        self.name, self._open = self._camera.name, False

    def connect(self) -> None:
        try:
            self._camera.__enter__()
        except FungraspError as error:
            raise RobotError(str(error)) from error
        self._open = True

    def newest(self, timeout: float) -> Frame | None:
        """See ``FrameSource.newest``. Raises: FungraspError: the camera fails, or there is no depth."""
        frame = self._camera.newest(timeout) if self._open else None
        return None if frame is None else Frame(frame.capture(), frame.time)

    def close(self) -> None:
        self._open = False
        self._camera.__exit__()


WAIT = 0.2
"""Longest wait for a frame before it is looked whether to end [s]."""

LOST_FRAMES = 10
"""After so many images in a row without the object it is searched for again."""

_log = logging.getLogger(__name__)


class CameraTracker(PoseSource):
    """Of a camera that stands still."""

    def __init__(
        self,
        frames: FrameSource,
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
        self._frames, self._thing, self._camera = frames, obj, np.asarray(pose_world_camera, dtype=float)
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
            self._frames.connect()
        except RobotError:
            raise
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
        self._frames.close()

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

    def _answer(self, frame: Frame) -> TrackedPose | None:
        """What an image says."""
        if self._tracker is None:
            return self._found(frame)
        began = time.thread_time()
        track = self._tracker.update(frame.capture.color, frame.capture.depth)
        self.seconds.append(time.thread_time() - began)
        followed = track.score >= FOLLOWED
        self._missed = 0 if followed else self._missed + 1
        if self._missed >= LOST_FRAMES:
            self._tracker, self._start, self._missed = None, None, 0
        status = TrackingStatus.TRACKING if followed else TrackingStatus.LOST
        return TrackedPose(compose(self._camera, track.pose), frame.captured, track.score, status)

    def _found(self, frame: Frame) -> TrackedPose | None:
        """The first pose: given or searched for; what was said last where the object is not there."""
        pose, score = self._start, 1.0
        if pose is None:
            found = estimate_object_pose(frame.capture, self._thing, seed=self._seed)
            if not found.accepted:
                return self._newest
            pose, score = found.pose_camera_object, found.score
        self._tracker = ObjectTracker(self._thing, frame.capture.intrinsics, pose, seed=self._seed)
        # The search took a second, in which the object may have moved: the next image says where it is.
        world = compose(self._camera, pose)
        return TrackedPose(world, frame.captured, score, TrackingStatus.INITIALIZING)
