"""Taking a capture from a running camera: wait until all is seen, count down, keep the best of some
frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import trimesh
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.objects import ObjectModel
from fungrasp.perception.camera.frames import CameraFrame, RgbdCamera
from fungrasp.perception.camera.readiness import (
    NEAREST,
    FrameProblem,
    FrameReadiness,
    judge_frame,
    judge_object,
)
from fungrasp.perception.hand.detected_hand import DetectedHand, HandDetector, find_hands, settle_side
from fungrasp.perception.hand.fit import fit_hand
from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
from fungrasp.perception.io.capture import Box, Capture
from fungrasp.perception.object_pose.estimate import estimate_object_pose
from fungrasp.perception.object_pose.tracker import FOLLOWED, ObjectTracker
from fungrasp.perception.scene.table import NO_TABLE

STEADY = 1.5
"""Frames that differ from their neighbors by no more than so many times the least count as steady."""

MARGIN = 0.3
"""The hand's box is widened by this part on each side: the object is beside it."""


def best_first(frames: Sequence[CameraFrame], around: Box) -> list[int]:
    """Indices of frames, best first: the steady ones by sharpness, then the others.

    Sharpness is the variance of the Laplacian of the brightness; steadiness the mean difference of brightness
    from the frames before and after.

    Args:
        frames: one after the other, of one size.
        around: the hand's box ``x0, y0, x1, y1`` [pixels]; only it and what is beside it counts.
    """
    gray = [frame.color[_part(frame, around)].mean(axis=-1, dtype=np.float32) for frame in frames]
    sharp = np.array([np.var(ndimage.laplace(image)) for image in gray])
    change = [float(np.abs(a - b).mean()) for a, b in pairwise(gray)]
    # The first and the last frame have one neighbor.
    moved = np.array([max(change[max(i - 1, 0) : i + 1], default=0.0) for i in range(len(gray))])
    shaky = moved > STEADY * moved.min() + 1e-6
    return [int(i) for i in np.lexsort((-sharp, shaky))]


def _part(frame: CameraFrame, box: Box) -> tuple[slice, slice]:
    x0, y0, x1, y1 = box
    across, down = MARGIN * (x1 - x0), MARGIN * (y1 - y0)
    width, height = frame.intrinsics.width, frame.intrinsics.height
    left, right = np.clip([x0 - across, x1 + across], 0, width).astype(int)
    top, bottom = np.clip([y0 - down, y1 + down], 0, height).astype(int)
    if right - left < 3 or bottom - top < 3:
        return slice(0, height), slice(0, width)
    return slice(top, bottom), slice(left, right)


SPEED = 60.0
"""Landmarks that move faster than this in an image 640 wide blur it: two pixels in 1/30 s [pixels/s]."""

FLICKER = 0.5
"""A problem that lasts no longer than this does not stop the countdown [s]: single frames are misjudged."""


@dataclass(frozen=True)
class LiveSettings:
    """How a capture is taken."""

    countdown: float = 3.0
    """Time between the moment when all is well and the picture [s]."""
    burst: int = 8
    """Frames of which the best is kept."""
    nearest: float = NEAREST
    """Distance at which the camera begins to measure [m]."""

    def __post_init__(self) -> None:
        if not (0 <= self.countdown <= 60 and self.burst >= 1):
            raise FungraspError(
                "a capture needs a countdown of 0 to 60 s and a burst of 1 frame or more, not "
                f"{self.countdown} and {self.burst}"
            )


@dataclass(frozen=True, eq=False)
class LiveView:
    """What is to be shown after a frame was looked at."""

    frame: CameraFrame
    """The frame."""
    readiness: FrameReadiness
    """What was found in it and what is missing."""
    pose_camera_object: np.ndarray | None
    """The object's pose in the camera frame, shape [7]; None: not known."""
    seconds_left: float | None
    """Until the picture is taken [s]; None: not counting down."""

    @property
    def words(self) -> str:
        """What to tell the person."""
        if self.seconds_left is not None:
            return f"all is seen; keep still: {np.ceil(self.seconds_left):.0f}"
        return "; ".join(map(str, self.readiness.problems)) or "all is seen"


class LiveCapture:
    """Waits for a frame in which all is seen. One object for one capture."""

    def __init__(
        self,
        camera: RgbdCamera,
        mesh: ObjectModel | trimesh.Trimesh,
        detector: HandDetector,
        settings: LiveSettings | None = None,
        hinted: Callable[[Capture], Capture] = lambda capture: capture,
    ):
        """
        Args:
            camera: opened already.
            mesh: the object that will be held [m].
            detector: finds hands.
            settings: countdown and burst.
            hinted: adds the object's mask, box or point to a capture, if one is known.
        """
        self._camera, self._mesh, self._detector = camera, mesh, detector
        self._settings, self._hinted = settings or LiveSettings(), hinted
        self._tracker: ObjectTracker | None = None
        self._last: tuple[float, DetectedHand] | None = None

    def take(self, show: Callable[[LiveView], None]) -> CameraFrame:
        """Wait, count down and take the picture.

        Args:
            show: is given every frame that was looked at.

        Returns:
            The sharpest of the steady frames at the end of the countdown in which nothing is missing.

        Raises:
            FungraspError: the recording ended before; the message says what was missing last. Or the camera
                failed.
        """
        ready_since = well_until = None
        last: LiveView | None = None
        frames = self._camera.frames()
        for frame in frames:
            readiness, pose = self.judge(frame)
            if not readiness.problems:
                ready_since = frame.time if ready_since is None else ready_since
                well_until = frame.time
            elif well_until is None or frame.time - well_until > FLICKER:
                ready_since = None
            left = None
            if ready_since is not None:
                left = max(0.0, self._settings.countdown - (frame.time - ready_since))
            last = LiveView(frame, readiness, pose, left)
            show(last)
            if left == 0.0 and not readiness.problems and readiness.hand is not None:
                taken = self._best(frame, frames, readiness.hand)
                if taken is not None:
                    return taken
                ready_since = well_until = None
        missing = "there were no frames" if last is None else f"last: {last.words}"
        raise FungraspError(f"{self._camera.name} ended before a picture could be taken; {missing}")

    def judge(self, frame: CameraFrame) -> tuple[FrameReadiness, np.ndarray | None]:
        """What is missing in a frame, the object and steadiness included, and the object's pose."""
        hands = find_hands(self._detector, frame)
        readiness = judge_frame(frame, hands, self._settings.nearest)
        pose, problem = None, None
        if readiness.hand is not None and not readiness.problems:
            pose, problem = self._object(frame, readiness)
        if problem is None and readiness.hand is not None:
            problem = self._motion(frame, readiness.hand)
        self._last = None if readiness.hand is None else (frame.time, readiness.hand)
        if problem is not None:
            readiness = replace(readiness, problems=(*readiness.problems, problem))
        return readiness, pose

    def _object(
        self, frame: CameraFrame, readiness: FrameReadiness
    ) -> tuple[np.ndarray | None, FrameProblem | None]:
        """Follow the object; search for it if it is not followed."""
        if self._tracker is not None:
            track = self._tracker.update(frame.color, frame.depth)
            if track.score >= FOLLOWED:
                return track.pose, None
            self._tracker = None
        assert readiness.hand is not None
        capture = self._hinted(frame.capture())
        hand = fit_hand(settle_side(readiness.hand)[0], capture)
        table = NO_TABLE if readiness.table is None else readiness.table
        estimate = estimate_object_pose(capture, self._mesh, hand, table)
        problem = judge_object(estimate)
        if problem is not None:
            return None, problem
        self._tracker = ObjectTracker(self._mesh, frame.intrinsics, estimate.pose_camera_object)
        return estimate.pose_camera_object, None

    def _motion(self, frame: CameraFrame, hand: DetectedHand) -> FrameProblem | None:
        """Whether the hand moves too fast since the frame before."""
        if self._last is None or frame.time <= self._last[0]:
            return None
        moved = hand.distance(self._last[1]) * 640 / frame.intrinsics.width
        # Landmarks tremble by a pixel or two, however short the time between frames.
        return FrameProblem.of("moving") if moved > max(SPEED * (frame.time - self._last[0]), 6.0) else None

    def _best(
        self, frame: CameraFrame, frames: Iterator[CameraFrame], hand: DetectedHand
    ) -> CameraFrame | None:
        """The best of this and the next frames in which nothing is missing; None if there is none."""
        burst = [frame]
        for following in frames:
            burst.append(following)
            if len(burst) >= self._settings.burst:
                break
        x0, y0, x1, y1 = (float(edge) for edge in hand.box)
        for i in best_first(burst, (x0, y0, x1, y1)):
            self._last = None
            if not self.judge(burst[i])[0].problems:
                return burst[i]
        return None


def live_capture(
    camera: RgbdCamera,
    obj: ObjectModel,
    settings: LiveSettings | None = None,
    show: Callable[[LiveView], None] | None = None,
    hinted: Callable[[Capture], Capture] = lambda capture: capture,
) -> Capture:
    """A capture taken by a camera when hand, table and object are seen.

    Args:
        camera: not yet started.
        obj: the object that will be held.
        settings: countdown and burst.
        show: is given every frame that was looked at, and what is missing in it.
        hinted: adds the object's mask, box or point to a capture, if one is known.

    Raises:
        FungraspError: the camera is missing or fails, or a recording ended before all was seen.
    """
    with camera as device:
        taken = LiveCapture(device, obj, MediaPipeHandDetector(), settings, hinted)
        return taken.take(show or (lambda view: None)).capture()
