"""Captures from a RealSense camera or its recording, with pyrealsense2 (extra ``realsense``).

pyrealsense2 has wheels for Linux and Windows on x86-64, and for Linux on arm64 with Python 3.12, but none for
macOS. On Linux, it needs the system's libusb-1.0.
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

RECORDINGS = (".bag", ".db3")  # File suffixes of recordings.
WARM_UP = 30  # Images that are skipped first, until exposure and white balance have settled.
FIRST_WAIT = 5000  # Longest wait for the first images [ms]: a camera has to start.
WAIT = 2000  # Longest wait for further images [ms]; after it, a recording is at its end.
# Supported color formats, and the positions of red, green and blue.
CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0]}
DISTORTION = 1e-6  # Largest distortion coefficient that is ignored.

_log = logging.getLogger(__name__)


def capture_from_camera(recording: str | Path | None = None, *, image: int | None = None) -> Capture:
    """Take one capture: color, and depth aligned to it.

    Args:
        recording: recording (``.bag``, newer ``.db3``); the first connected camera if None.
        image: number of the image, from 0; None: the image after ``WARM_UP`` others, or the last one of a
            shorter recording.

    Raises:
        FungraspError: pyrealsense2 is not installed or can't be loaded; there is no camera or it gives no
            images; the recording is missing, damaged, too short or without color or depth; or its depth is
            implausible.
    """
    if image is not None and image < 0:
        raise FungraspError(f"images are numbered from 0; there is no image {image}")
    with RealSenseCamera(recording) as camera:
        return camera.capture(image)


@dataclass(frozen=True)
class StreamSettings:
    """Streams of a connected camera."""

    width: int = 640
    """Width of both images [pixels]."""
    height: int = 480
    """Height of both images [pixels]."""
    rate: int = 30
    """Frame rate [1/s]."""


class RealSenseCamera:
    """A connected RealSense camera or a recording; see ``RgbdCamera``."""

    def __init__(
        self, recording: str | Path | None = None, *, serial: str = "", stream: StreamSettings | None = None
    ):
        """
        Args:
            recording: ``.bag`` or newer ``.db3``, played as fast as frames are read; a camera if None.
            serial: serial number of the camera; "" for the first connected one.
            stream: size and rate of a camera's images; its default if None.
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
        """Start the streams.

        Raises:
            FungraspError: pyrealsense2 is not installed or can't be loaded, there is no camera, or the
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
            # A recording keeps its own formats.
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
        """Stop the streams."""
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None

    def newest(self, timeout: float) -> CameraFrame | None:
        """Return the newest frame not returned before, or None if none comes in time; older ones are dropped.

        Args:
            timeout: longest wait [s].

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
        """Take one capture; arguments and errors as in ``capture_from_camera``."""
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
        """Return the frame with depth aligned to color."""
        aligned = self._rs.align(self._rs.stream.color).process(frames)
        if not self._checked and _distorted(aligned):
            _log.warning("%s: the lens's distortion is not taken into account", self.name)
        self._checked = True
        return _frame(self._rs, aligned, self._unit, self.name)


def _module() -> Any:
    """Import pyrealsense2. Raises: FungraspError: it is not installed or can't be loaded."""
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
        # A copy, because the library reuses its buffer.
        np.array(np.asarray(color.get_data())[..., order], dtype=np.uint8),
        np.asarray(depth.get_data()).astype(np.float32) * np.float32(unit),
        Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy),
        _taken(rs, depth),
    )


def _distorted(frames: Any) -> bool:
    """Return whether the color image has distortion."""
    color = frames.get_color_frame()
    if not color:
        return False
    lens = color.profile.as_video_stream_profile().get_intrinsics()
    return bool(np.abs(np.asarray(lens.coeffs, dtype=float)).max(initial=0.0) > DISTORTION)


def _taken(rs: Any, depth: Any) -> float:
    """Return when a depth image was taken, ``time.monotonic`` [s]: by its time stamp if that is of this
    computer's clock, otherwise now."""
    now = time.monotonic()
    domain = depth.get_frame_timestamp_domain()
    if domain not in (rs.timestamp_domain.global_time, rs.timestamp_domain.system_time):
        return now
    return now - (time.time() - 0.001 * float(depth.get_timestamp()))
