"""Writes that a limit or a stop rests on: each is repeated until the device shows that it has it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from fungrasp.robots.device import RobotError

PATIENCE = 1.0
"""A device that does not show a value within this time does not take it [s]."""
INTERVAL = 0.02
"""Between two attempts at the same value [s]."""


class ConfirmedWrites:
    """What a device must have been told. A lost write, a refused one and one that only some of its motors
    heard look alike: the value is not shown, and is written again."""

    def __init__(self, write: Callable[[str, Any], bool]):
        """
        Args:
            write: writes a value once and says whether the device shows it, by an acknowledgment or by what
                is read back; takes the name and the value.
        """
        self._write = write
        self._shown: dict[str, Any] = {}
        self._open: dict[str, tuple[Any, float, float]] = {}

    def put(self, name: str, value: Any, anew: bool = False) -> None:
        """Want a value from now on; the newest counts.

        Args:
            name: of what is written, for messages.
            anew: write it though it was shown before.
        """
        if anew or self.wanted(name) != value:
            since = self._open[name][1] if name in self._open else time.monotonic()
            self._open[name] = (value, since, 0.0)

    def forget(self, *names: str) -> None:
        """The device may have been switched off: what it has been told of some names is told again."""
        for name in names:
            if name in self._shown:
                self._open.setdefault(name, (self._shown.pop(name), time.monotonic(), 0.0))

    def wanted(self, name: str) -> Any:
        """The newest value of a name; None where there is none."""
        return self._open[name][0] if name in self._open else self._shown.get(name)

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of what is not shown yet."""
        return tuple(self._open)

    def work(self) -> str:
        """Write once what is not shown yet. Returns: what the device does not take, as a phrase; "" for
        nothing."""
        for name, (value, since, tried) in list(self._open.items()):
            if time.monotonic() - tried < INTERVAL:
                continue
            self._open[name] = (value, since, time.monotonic())
            if self._write(name, value):
                self._shown[name] = value
                del self._open[name]
        now = time.monotonic()
        late = [name for name, (_, since, _) in self._open.items() if now - since > PATIENCE]
        return f"it does not take what it is told: {', '.join(late)}" if late else ""

    def finish(self, device: str) -> None:
        """Write until all is shown.

        Args:
            device: type and address, for messages.

        Raises:
            RobotError: the device does not take it.
        """
        while self._open:
            late = self.work()
            if late:
                raise RobotError(f"{device}: {late}")
            if self._open:
                time.sleep(INTERVAL / 4)
