"""Images of a depth camera, one after the other: live or recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from fungrasp.core.errors import FungraspError
from fungrasp.perception import Capture
from fungrasp.perception.io.realsense import RealSenseCamera, StreamSettings
from fungrasp.robots.device import RobotError


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


class RecordedFrames:
    """Captures at the rate at which they were taken."""

    def __init__(
        self,
        captures: Sequence[Capture],
        rate: float,
        clock: Callable[[], float] = time.monotonic,
        *,
        all_of_them: bool = False,
    ):
        """
        Args:
            captures: one or more.
            rate: of the recording [1/s].
            clock: host time [s].
            all_of_them: give all, however late; else those whose time has passed are left out, as a camera
                leaves them out.
        """
        if not captures or not rate > 0:
            raise RobotError("recorded frames need one capture or more, and a positive rate")
        self.name = f"{len(captures)} recorded frames"
        self._captures, self._rate, self._clock = captures, rate, clock
        self._all = all_of_them
        self._began: float | None = None
        self._last = -1

    def connect(self) -> None:
        """See ``FrameSource.connect``."""
        self._began, self._last = self._clock(), -1

    def newest(self, timeout: float) -> Frame | None:
        """See ``FrameSource.newest``."""
        if self._began is None or self._last + 1 >= len(self._captures):
            time.sleep(timeout)
            return None
        due = self._began + (self._last + 1) / self._rate
        if due > self._clock() + timeout:
            time.sleep(timeout)
            return None
        time.sleep(max(0.0, due - self._clock()))
        now = int((self._clock() - self._began) * self._rate + 1e-6)
        following = self._last + 1
        self._last = following if self._all else min(max(now, following), len(self._captures) - 1)
        return Frame(self._captures[self._last], self._began + self._last / self._rate)

    def close(self) -> None:
        """See ``FrameSource.close``."""
        self._began = None


class RealSenseFrames:
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
        """See ``FrameSource.connect``."""
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
        """See ``FrameSource.close``."""
        self._open = False
        self._camera.__exit__()
