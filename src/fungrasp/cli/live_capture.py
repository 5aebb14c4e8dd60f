"""Taking the image of a command with a running camera: what is missing is said, then it counts down."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fungrasp.cli.optional_value import optional_value

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel
    from fungrasp.perception import Capture
    from fungrasp.perception.camera.frames import RgbdCamera
    from fungrasp.perception.camera.live import LiveView

REALSENSE = "realsense"
"""Stands for the RealSense camera that is connected."""


CameraChoice = Annotated[str | None, optional_value("[realsense|FOLDER]", REALSENSE, "camera")]
"""An option with or without a value."""


def opened_camera(name: str) -> RgbdCamera:
    """The camera of that name, not yet started.

    Raises:
        FungraspError: it is neither "realsense" nor a folder of frames.
    """
    from fungrasp.errors import FungraspError
    from fungrasp.perception.camera.recorded import FolderCamera
    from fungrasp.perception.io.realsense import RealSenseCamera

    if Path(name).is_dir():
        return FolderCamera(name)
    if name == REALSENSE:
        return RealSenseCamera()
    raise FungraspError(f"--camera is {REALSENSE}, or a folder that has a capture's folder for each frame")


def live_capture(
    camera: str,
    model: ObjectModel,
    countdown: float,
    page: bool,
    hinted: Callable[[Capture], Capture],
) -> Capture:
    """A capture taken when all is seen.

    Args:
        camera: see ``opened_camera``.
        model: the object that will be held.
        countdown: seconds between all being seen and the picture.
        page: whether the camera's picture is served on a page.
        hinted: adds what is known of the object's place in the image.

    Raises:
        FungraspError: the camera is missing or fails, or a recording ended before all was seen.
    """
    from fungrasp.perception.camera.live import LiveCapture, LiveSettings
    from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
    from fungrasp.report.live_page import LivePage

    settings = LiveSettings(countdown=countdown)
    with ExitStack() as stack:
        device = stack.enter_context(opened_camera(camera))
        detector = MediaPipeHandDetector()
        shown = stack.enter_context(LivePage(model)) if page else None
        if shown is not None:
            print(f"the camera's picture: {shown.address} (on this computer only); Ctrl-C ends", flush=True)
        said = ""

        def show(view: LiveView) -> None:
            nonlocal said
            if shown is not None:
                shown.show(view)
            if view.words != said:
                said = view.words
                print(said, flush=True)

        frame = LiveCapture(device, model, detector, settings, hinted).take(show)
        if shown is not None:
            shown.say("the picture is taken", done=True)
        print("the picture is taken", flush=True)
    return frame.capture()
