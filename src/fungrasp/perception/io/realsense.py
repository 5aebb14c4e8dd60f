"""A capture from a RealSense camera, live or recorded, by pyrealsense2 (extra ``realsense``).

pyrealsense2 has wheels for Linux and Windows on x86-64, and for Linux on arm64 with Python 3.12; none for
macOS. On Linux it needs the system's libusb-1.0.
"""

from __future__ import annotations

import importlib
import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line
from fungrasp.perception.io.capture import CameraFrame, Capture, Intrinsics
from fungrasp.perception.io.image_files import check_depth_range

RECORDINGS = (".bag", ".db3")  # Kinds of files in which a camera's images are recorded.
WARM_UP = 30  # Images that are left out first: exposure and white balance settle in them.
FIRST_WAIT = 5000  # Longest time that the first images may take [ms]: a camera has to start.
WAIT = 2000  # Longest time that each further one may take [ms]; a recording that gives none is at its end.
# Formats of color that are understood, and where red, green and blue are in them.
CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0]}
DISTORTION = 1e-6  # Coefficients below this are none.

_log = logging.getLogger(__name__)


def capture_from_camera(recording: str | Path | None = None, *, image: int | None = None) -> Capture:
    """Take one capture: color, and depth aligned to it.

    Args:
        recording: a recording (``.bag``, newer ``.db3``) to take it from; None takes the first camera that is
            connected.
        image: number of the image that is taken, the first is 0; None takes the one after ``WARM_UP`` others,
            or a shorter recording's last.

    Raises:
        FungraspError: pyrealsense2 is not installed or can't be loaded, no camera is there or it gives no
            images, the recording is missing, damaged, too short or without color or depth, or its depth
            can't be right.
    """
    if image is not None and image < 0:
        raise FungraspError(f"images are numbered from 0; there is no image {image}")
    with RealSenseCamera(recording) as camera:
        return camera.capture(image)


@dataclass(frozen=True)
class StreamSettings:
    """What a connected camera is asked for."""

    width: int = 640
    """Of both images [pixels]."""
    height: int = 480
    """Of both images [pixels]."""
    rate: int = 30
    """Of frames [1/s]."""


class RealSenseCamera:
    """A RealSense camera that is connected, or a recording of one; see ``RgbdCamera``."""

    def __init__(
        self, recording: str | Path | None = None, *, serial: str = "", stream: StreamSettings | None = None
    ):
        """
        Args:
            recording: ``.bag`` or newer ``.db3``; it is played as fast as its frames are asked for. None: a
                camera.
            serial: number of the camera; "" for the first that is connected.
            stream: size and rate of a camera's images; what the camera prefers if None.
        """
        self.name = f"RealSense camera {serial}" if serial else "the camera"
        if recording is not None:
            self.name = str(recording)
        self._recording, self._serial, self._stream = recording, serial, stream
        self._pipeline: Any = None
        self._rs: Any = None
        self._unit = 0.0
        self._checked = False

    def __enter__(self) -> Self:
        """Start it.

        Raises:
            FungraspError: pyrealsense2 is not installed or can't be loaded, no camera is there, or the
                recording is missing, damaged or without color or depth.
        """
        if self._recording is not None and not Path(self._recording).is_file():
            raise FungraspError(f"the recording {self._recording} does not exist")
        rs = self._rs = _module()
        pipeline, config = rs.pipeline(), rs.config()
        if self._recording is None:
            s = self._stream
            for stream, kind in ((rs.stream.depth, rs.format.z16), (rs.stream.color, rs.format.rgb8)):
                if s is None:
                    config.enable_stream(stream, kind)
                else:
                    config.enable_stream(stream, s.width, s.height, kind, s.rate)
            if self._serial:
                config.enable_device(self._serial)
        else:
            # A recording has the formats that it has.
            config.enable_device_from_file(str(self._recording), repeat_playback=False)
            config.enable_stream(rs.stream.depth)
            config.enable_stream(rs.stream.color)
        try:
            profile = pipeline.start(config)
        except RuntimeError as error:
            raise FungraspError(_why_not_started(self._recording, self._serial, error)) from error
        self._pipeline = pipeline
        try:
            device = profile.get_device()
            if self._recording is not None:
                device.as_playback().set_real_time(False)
            self._unit = float(device.first_depth_sensor().get_depth_scale())
        except RuntimeError as error:
            self.__exit__()
            raise self._failed(error) from error
        return self

    def __exit__(self, *error: object) -> None:
        """Stop it."""
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None

    def newest(self, timeout: float) -> CameraFrame | None:
        """The newest frame that was not given yet; those that have queued before it are left out. None if
        none comes in time.

        Args:
            timeout: to wait [s].

        Raises:
            FungraspError: the camera fails.
        """
        try:
            there, frames = self._pipeline.try_wait_for_frames(round(1000 * timeout))
            more = there
            while more:
                more, newer = self._pipeline.try_wait_for_frames(1)
                frames = newer if more else frames
            return self._aligned(frames) if there else None
        except RuntimeError as error:
            raise self._failed(error) from error

    def capture(self, image: int | None = None) -> Capture:
        """One capture; arguments and errors as of ``capture_from_camera``."""
        frames = None
        try:
            for count in range(1 + (WARM_UP if image is None else image)):
                there, latest = self._pipeline.try_wait_for_frames(FIRST_WAIT if count == 0 else WAIT)
                if not there:
                    if image is not None and count:
                        raise FungraspError(
                            f"{self.name} has no image {image}: its images are 0 to {count - 1}"
                        )
                    break
                frames = latest
            if frames is None:
                raise FungraspError(f"{self.name} gives no images: none in {FIRST_WAIT / 1000:g} s")
            frame = self._aligned(frames)
        except RuntimeError as error:
            raise self._failed(error) from error
        check_depth_range(frame.depth, self._unit, self.name)
        return frame.capture()

    def _failed(self, error: RuntimeError) -> FungraspError:
        return FungraspError(f"{self.name} failed: {one_line(error)}")

    def _aligned(self, frames: Any) -> CameraFrame:
        """The frame with its depth aligned to its color."""
        aligned = self._rs.align(self._rs.stream.color).process(frames)
        if not self._checked and _distorted(aligned):
            _log.warning("%s: the lens's distortion is not taken into account", self.name)
        self._checked = True
        return _frame(self._rs, aligned, self._unit, self.name)


def _module() -> Any:
    """pyrealsense2. Raises: FungraspError: it is not installed or can't be loaded."""
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError as error:
        raise FungraspError(
            'RealSense needs pyrealsense2: pip install ".[realsense]" in the clone (Linux, Windows on '
            "x86-64, Linux on arm64 with Python 3.12; there is none for macOS); or save the images with "
            "another program and give them as files"
        ) from error
    except ImportError as error:
        hint = "; install it with: apt install libusb-1.0-0" if "libusb" in str(error) else ""
        raise FungraspError(
            f"pyrealsense2 is installed but can't be loaded: {one_line(error)}{hint}"
        ) from error


def _why_not_started(recording: str | Path | None, serial: str, error: RuntimeError) -> str:
    reason = one_line(error)
    if recording is not None:
        return (
            f"the recording {recording} can't be played: is it damaged, or is color or depth missing? "
            f"({reason})"
        )
    if "No device" in reason:
        which = f"no RealSense camera {serial}".rstrip()
        return f"{which} is connected, or this user may not use it (librealsense's udev rules)"
    return (
        "the RealSense camera gives no depth and color together: is another program using it, or is it on a "
        f"slow USB port? ({reason})"
    )


def _frame(rs: Any, frames: Any, unit: float, where: str) -> CameraFrame:
    depth, color = frames.get_depth_frame(), frames.get_color_frame()
    if not depth or not color:
        missing = "color" if depth else "depth"
        raise FungraspError(f"{where} has no {missing} image: both are needed, taken at the same time")
    profile = color.profile.as_video_stream_profile()
    order = {getattr(rs.format, name): channels for name, channels in CHANNELS.items()}.get(profile.format())
    if order is None:
        raise FungraspError(
            f"{where} has color in the format {profile.format()}; one of {', '.join(CHANNELS)} is needed"
        )
    lens = profile.get_intrinsics()
    return CameraFrame(
        # A copy: the library's buffer is used again.
        np.array(np.asarray(color.get_data())[..., order], dtype=np.uint8),
        np.asarray(depth.get_data()).astype(np.float32) * np.float32(unit),
        Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy),
        _taken(rs, depth),
    )


def _distorted(frames: Any) -> bool:
    """Whether the color image has a distortion worth mentioning."""
    color = frames.get_color_frame()
    if not color:
        return False
    lens = color.profile.as_video_stream_profile().get_intrinsics()
    return bool(np.abs(np.asarray(lens.coeffs, dtype=float)).max(initial=0.0) > DISTORTION)


def _taken(rs: Any, depth: Any) -> float:
    """When a depth image was taken, ``time.monotonic`` [s]: by its time stamp, however old that is, if it is
    of this computer's clock, else now."""
    now = time.monotonic()
    domain = depth.get_frame_timestamp_domain()
    if domain not in (rs.timestamp_domain.global_time, rs.timestamp_domain.system_time):
        return now
    return now - (time.time() - 0.001 * float(depth.get_timestamp()))
