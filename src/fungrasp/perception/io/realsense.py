"""A capture from a RealSense camera, live or recorded, by pyrealsense2 (extra ``realsense``).

pyrealsense2 has wheels for Linux and Windows on x86-64, and for Linux on arm64 with Python 3.12; none for
macOS. On Linux it needs the system's libusb-1.0.
"""

from __future__ import annotations

import importlib
import logging
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.capture_checks import check_depth_range

FIRST_WAIT = 5000
"""Longest time that the first images may take [ms]: a camera has to start."""

WAIT = 2000
"""Longest time that each further one may take [ms]; a recording that gives none is at its end."""

CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0]}
"""Formats of colour that are understood, and where red, green and blue are in them."""

DISTORTION = 1e-6
"""Coefficients below this are none."""

_log = logging.getLogger(__name__)


def capture_from_camera(
    recording: str | Path | None = None, warm_up: int = 30, *, image: int | None = None
) -> Capture:
    """Take one capture: colour, and depth aligned to it.

    Args:
        recording: a recording (``.bag``, newer ``.db3``) to take it from; None takes the first camera that is
            connected.
        warm_up: images left out before, in which exposure and white balance settle. Of a shorter recording
            the last image is taken.
        image: number of the image that is taken, the first is 0; None takes the one after the warm-up.

    Raises:
        FungraspError: pyrealsense2 is not installed or can't be loaded, no camera is there or it gives no
            images, the recording is missing, damaged, too short or without colour or depth, or its depth
            can't be right.
    """
    if warm_up < 0:
        raise FungraspError(f"the number of images left out before must not be negative, not {warm_up}")
    if image is not None and image < 0:
        raise FungraspError(f"images are numbered from 0; there is no image {image}")
    if recording is not None and not Path(recording).is_file():
        raise FungraspError(f"the recording {recording} does not exist")
    rs = realsense_module()
    where = "the camera" if recording is None else str(recording)
    pipeline, config = rs.pipeline(), rs.config()
    if recording is None:
        config.enable_stream(rs.stream.depth, rs.format.z16)
        config.enable_stream(rs.stream.color, rs.format.rgb8)
    else:
        # A recording has the formats that it has.
        config.enable_device_from_file(str(recording), repeat_playback=False)
        config.enable_stream(rs.stream.depth)
        config.enable_stream(rs.stream.color)
    try:
        profile = pipeline.start(config)
    except RuntimeError as error:
        raise FungraspError(_why_not_started(recording, error)) from error
    try:
        device = profile.get_device()
        if recording is not None:
            device.as_playback().set_real_time(False)
        unit = float(device.first_depth_sensor().get_depth_scale())
        frames = _wait(pipeline, warm_up, image, where)
        return capture_of_frames(rs, rs.align(rs.stream.color).process(frames), unit, where)
    except RuntimeError as error:
        raise FungraspError(f"{where} failed: {_line(error)}") from error
    finally:
        pipeline.stop()


def realsense_module() -> Any:
    """pyrealsense2. Raises: FungraspError: it is not installed or can't be loaded."""
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError as error:
        raise FungraspError(
            "a RealSense camera needs pyrealsense2: pip install 'fungrasp[realsense]' (Linux and Windows on "
            "x86-64, Linux on arm64 with Python 3.12; there is none for macOS); or save the images with "
            "another program and give them as files"
        ) from error
    except ImportError as error:
        hint = "; install it with: apt install libusb-1.0-0" if "libusb" in str(error) else ""
        raise FungraspError(f"pyrealsense2 is installed but can't be loaded: {_line(error)}{hint}") from error


def _why_not_started(recording: str | Path | None, error: RuntimeError) -> str:
    reason = _line(error)
    if recording is not None:
        return (
            f"the recording {recording} can't be played: is it damaged, or is colour or depth missing? "
            f"({reason})"
        )
    if "No device" in reason:
        return "no RealSense camera is connected, or this user may not use it (librealsense's udev rules)"
    return (
        "the RealSense camera gives no depth and colour together: is another program using it, or is it on a "
        f"slow USB port? ({reason})"
    )


def _wait(pipeline: Any, warm_up: int, image: int | None, where: str) -> Any:
    """The frames of an image; those after the warm-up, or the last there are, if none is asked for."""
    frames = None
    for count in range(1 + (warm_up if image is None else image)):
        there, latest = pipeline.try_wait_for_frames(FIRST_WAIT if count == 0 else WAIT)
        if not there:
            if image is not None and count:
                raise FungraspError(f"{where} has no image {image}: its images are 0 to {count - 1}")
            break
        frames = latest
    if frames is None:
        raise FungraspError(f"{where} gives no images: none in {FIRST_WAIT / 1000:g} s")
    return frames


def capture_of_frames(rs: Any, frames: Any, unit: float, where: str) -> Capture:
    """Colour and aligned depth of one set of frames. unit: of the depth [m]. where: for messages.

    Raises:
        FungraspError: one of the images is missing or can't be right.
    """
    depth, color = frames.get_depth_frame(), frames.get_color_frame()
    if not depth or not color:
        missing = "colour" if depth else "depth"
        raise FungraspError(f"{where} has no {missing} image: both are needed, taken at the same time")
    profile = color.profile.as_video_stream_profile()
    order = {getattr(rs.format, name): channels for name, channels in CHANNELS.items()}.get(profile.format())
    if order is None:
        raise FungraspError(
            f"{where} has colour in the format {profile.format()}; one of {', '.join(CHANNELS)} is needed"
        )
    lens = profile.get_intrinsics()
    if np.abs(np.asarray(lens.coeffs, dtype=float)).max(initial=0.0) > DISTORTION:
        _log.warning("%s: the lens's distortion is not taken into account", where)
    metres = np.asarray(depth.get_data()).astype(np.float32) * np.float32(unit)
    check_depth_range(metres, unit, where)
    return Capture(
        # A copy: the library's buffer is used again.
        np.array(np.asarray(color.get_data())[..., order], dtype=np.uint8),
        metres,
        Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy),
    )


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
