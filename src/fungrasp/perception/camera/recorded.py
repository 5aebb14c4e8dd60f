"""A recorded stream of a depth camera: a folder with a capture's folder for each frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Self

from fungrasp.errors import FungraspError
from fungrasp.perception.camera.frames import CameraFrame
from fungrasp.perception.io.scene_folders import own_files, read_folder

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
