"""The stop switch of software: a key, a file, or a call. It does not replace the robot's emergency stop."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self


class StopSwitch:
    """Once pressed it stays pressed. A context manager, which listens to the keyboard meanwhile."""

    def __init__(self, file: str | Path = "", keyboard: bool = False):
        """
        Args:
            file: pressed as soon as it exists; "" for none.
            keyboard: whether Enter or the space bar followed by Enter presses it.
        """
        self._file = Path(file) if file else None
        self._keyboard = keyboard and sys.stdin is not None and sys.stdin.isatty()
        self._reason = ""

    def press(self, reason: str) -> None:
        """Press it. reason: a phrase."""
        self._reason = self._reason or reason

    @property
    def reason(self) -> str:
        """Why it is pressed, as a phrase; "" while it is not."""
        if not self._reason and self._file is not None and self._file.exists():
            self._reason = f"the stop file {self._file} exists"
        return self._reason

    def __enter__(self) -> Self:
        if self._keyboard:
            threading.Thread(target=self._listen, args=(sys.stdin.readline,), daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def _listen(self, readline: Callable[[], str]) -> None:
        if readline():
            self.press("the stop key was pressed")
