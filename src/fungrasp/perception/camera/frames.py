"""The interface of a depth camera, and the frames it gives.

A camera is a context manager; ``frames`` gives the newest frame again and again. ``RealSenseCamera``
(``perception.io.realsense``) and ``FolderCamera`` are two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.scene_folders import own_files, read_folder


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One color image and the depth aligned to it. Unlike a ``Capture``, it may lack all depth."""

    color: np.ndarray
    """RGB, uint8, shape [H, W, 3]."""
    depth: np.ndarray
    """Distance along the optical axis [m], float32, shape [H, W]; 0: no measurement."""
    intrinsics: Intrinsics
    """Of both images."""
    time: float
    """When the images were taken [s]: ``time.monotonic`` for live cameras, since the first frame for
    recordings."""

    def __post_init__(self) -> None:
        shape = (self.intrinsics.height, self.intrinsics.width)
        if self.color.dtype != np.uint8 or self.color.shape != (*shape, 3):
            raise FungraspError(
                f"a frame's color must be uint8 of shape {[*shape, 3]}, not {self.color.dtype} of "
                f"{list(self.color.shape)}"
            )
        if self.depth.dtype != np.float32 or self.depth.shape != shape:
            raise FungraspError(
                f"a frame's depth must be float32 of shape {list(shape)}, not {self.depth.dtype} of "
                f"{list(self.depth.shape)}"
            )

    def capture(self) -> Capture:
        """The frame as a capture.

        Raises:
            FungraspError: there is no depth in it, or one that can't be right.
        """
        return Capture(self.color, self.depth, self.intrinsics)


class RgbdCamera(Protocol):
    """A depth camera, live or recorded. It is opened by ``with camera:``."""

    name: str
    """For messages."""

    def __enter__(self) -> Self:
        """Start the camera.

        Raises:
            FungraspError: it is not there, or does not work; the message says what to do.
        """
        ...

    def __exit__(self, *error: object) -> None:
        """Stop the camera."""
        ...

    def frames(self) -> Iterator[CameraFrame]:
        """Frame after frame, each the newest there is; ends where a recording ends.

        Raises:
            FungraspError: no frame comes any more.
        """
        ...


RATE = 10.0
"""Frames per second that a folder is played at if nothing else is said."""


class FolderCamera:
    """Plays captures out of folders. Nothing waits: the time stamps alone say how much time goes by."""

    def __init__(self, folder: str | Path, rate: float = RATE):
        """
        Args:
            folder: with a capture's folder for each frame, see ``read_folder``, played in the order of their
                names; or one capture's folder, which is played for ever.
            rate: frames per second.

        Raises:
            FungraspError: the folder is missing or has no captures, or the rate is not positive.
        """
        folder = Path(folder)
        if not rate > 0:
            raise FungraspError(f"frames per second must be positive, not {rate}")
        if not folder.is_dir():
            raise FungraspError(f"the folder of frames {folder} does not exist")
        self.name = str(folder)
        self._rate = rate
        self._still = own_files(folder) is not None
        inner = [path for path in folder.iterdir() if path.is_dir() and own_files(path) is not None]
        self._folders = [folder] if self._still else sorted(inner)
        if not self._folders:
            raise FungraspError(
                f"{folder} has no frames: it must have a folder for each, with rgb.png, depth.png and K.json"
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        return None

    def frames(self) -> Iterator[CameraFrame]:
        """See ``RgbdCamera.frames``. The first frame's time is 0."""
        number, captures = 0, map(read_folder, self._folders)
        for capture in captures:
            while True:
                yield CameraFrame(capture.color, capture.depth, capture.intrinsics, number / self._rate)
                number += 1
                if not self._still:
                    break
