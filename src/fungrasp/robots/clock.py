"""The clock of a robot: that of the wall, or that of a twin that is simulated as fast as it goes."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Time [s], of an origin of its own; it never goes back."""
        ...

    def sleep_until(self, when: float) -> None:
        """Return at a time [s], at once if it has passed."""
        ...


class WallClock:
    """``time.monotonic``."""

    def now(self) -> float:
        """See ``Clock.now``."""
        return time.monotonic()

    def sleep_until(self, when: float) -> None:
        """See ``Clock.sleep_until``."""
        left = when - time.monotonic()
        if left > 0:
            time.sleep(left)
