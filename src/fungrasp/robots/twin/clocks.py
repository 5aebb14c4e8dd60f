"""What drives a twin: its own clock, as fast as it goes, or the clock of the wall."""

from __future__ import annotations

import time
from threading import Event, Thread
from typing import Self

from fungrasp.robots.twin.world import TwinWorld

WALL_STEP = 0.002
"""Time between two advances on the clock of the wall [s]."""

LARGEST_LAG = 0.02
"""A twin that is farther behind than this loses the time [s]: on a computer that is too slow or too busy it
moves in slow motion, and does not jump."""


class TwinClock:
    """A clock that stands still while the robot's computer works: waiting advances the twin. Runs repeat to
    the last bit."""

    def __init__(self, world: TwinWorld):
        """world: that is advanced."""
        self._world = world

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._world.time

    def sleep_until(self, when: float) -> None:
        """See ``Clock.sleep_until``."""
        self._world.advance(when)


class RealTimeTwin:
    """Advances a twin on the clock of the wall in a thread of its own; a context manager."""

    def __init__(self, world: TwinWorld):
        """world: that is advanced; its time becomes that of ``time.monotonic``."""
        self._world, self._end = world, Event()
        self._thread = Thread(target=self._run, name="twin", daemon=True)
        self.latest = 0.0
        """How far the twin has fallen behind the clock at worst [s]."""
        self.lost = 0.0
        """Time that it has lost in all [s]."""

    def __enter__(self) -> Self:
        with self._world.lock:
            self._world.offset = time.monotonic() - self._world.data.time
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._end.is_set():
            with self._world.lock:
                lag = time.monotonic() - self._world.time
                self.latest = max(self.latest, lag)
                if lag > LARGEST_LAG:
                    self._world.offset += lag - LARGEST_LAG
                    self.lost += lag - LARGEST_LAG
            self._world.advance(self._world.time + min(lag, LARGEST_LAG))
            time.sleep(WALL_STEP)
