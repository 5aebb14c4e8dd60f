"""A camera that plays captures."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from fungrasp.perception import Capture
from fungrasp.robots.device import RobotError
from fungrasp.robots.pose.camera import Frame


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
