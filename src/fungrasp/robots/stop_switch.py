"""A stop switch in software: a key, a file, or a call. It does not replace the robot's emergency stop."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self


class StopSwitch:
    """Stays pressed once it is pressed. As a context manager, it listens to the keyboard."""

    def __init__(self, file: str | Path = "", keyboard: bool = False):
        """
        Args:
            file: file that presses it as soon as it exists; "" for none.
            keyboard: whether Enter in a terminal presses it.
        """
        self._file = Path(file) if file else None
        self.keyboard = keyboard and sys.stdin is not None and sys.stdin.isatty()
        """Whether it listens to a keyboard."""
        self._reason, self._asking = "", False
        self._answers: queue.Queue[str] = queue.Queue()

    def press(self, reason: str) -> None:
        """Press the switch. reason: a phrase."""
        self._reason = self._reason or reason

    @property
    def reason(self) -> str:
        """Reason for which it was pressed, as a phrase; "" while it is not pressed."""
        if not self._reason and self._file is not None and self._file.exists():
            self._reason = f"the stop file {self._file} exists"
        return self._reason

    @property
    def ways(self) -> str:
        """Ways to press it, as a phrase; "" if there are none."""
        ways = ["press Enter"] * self.keyboard
        if self._file is not None:
            ways.append(f"make the file {self._file}")
        return " or ".join(ways)

    def ask(self, question: str, meanwhile: Callable[[], None] | None = None) -> str:
        """Ask a question at the keyboard and return the next line, which does not press the switch.
        meanwhile: called repeatedly while waiting; its exceptions end the question. Raises: EOFError: there
        is no keyboard."""
        if not self.keyboard:
            raise EOFError("no terminal")
        self._asking = True
        sys.stderr.write(question)
        sys.stderr.flush()
        try:
            while meanwhile is not None and self._answers.empty():
                meanwhile()
            answer = self._answers.get()
        finally:
            self._asking = False
        if not answer:
            raise EOFError("the terminal has closed")
        return answer.strip()

    def __enter__(self) -> Self:
        if self.keyboard:
            threading.Thread(target=self._listen, args=(sys.stdin.readline,), daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def _listen(self, readline: Callable[[], str]) -> None:
        line = "first"
        while line:
            try:
                line = readline()
            except OSError:
                # The terminal has closed.
                line = ""
            if self._asking or not line:
                self._answers.put(line)
            if not self._asking:
                closed = "the terminal has closed, so the stop key no longer works"
                self.press("the stop key was pressed" if line else closed)
