"""A process of control that is spoiled from outside, and what it says."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

PRELOADED = ("benchmarks.fault_series.wire_session", "mink")
"""What sessions import: a server that has done so forks them."""


class ControlProcess:
    """A session of control in a process of its own; a context manager that leaves none of its processes.

    It tells its drivers' processes as the message ``("drivers", (process of the arm's, of the hand's))``.
    """

    def __init__(self, run: Callable[..., None], task: object):
        """
        Args:
            run: main function of the process: takes the task and its end of a pipe.
            task: what it does.
        """
        # Forked, each session begins at once, without the threads of the emulators in this process.
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(PRELOADED))
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=run, args=(task, other), daemon=False)
        self._process.start()
        other.close()
        self._drivers: tuple[int | None, ...] = ()
        self.heard: dict[str, tuple[Any, ...]] = {}
        """The last message of each kind."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.signal(signal.SIGKILL)
        self._process.join()
        self._pipe.close()
        # Drivers end by themselves when their input ends; those of a killed computer have been killed.
        deadline = time.monotonic() + 10.0
        while any(map(_alive, self._drivers)) and time.monotonic() < deadline:
            time.sleep(0.01)
        self.kill_drivers()

    @property
    def alive(self) -> bool:
        """Whether the session runs; one that is stopped by a signal does."""
        return _alive(self._process.pid)

    def listen(self, timeout: float) -> None:
        """Hear what it says, for so long at most [s]."""
        try:
            while self._pipe.poll(timeout):
                what, *values = self._pipe.recv()
                self.heard[what] = tuple(values)
                if what == "drivers":
                    self._drivers = values[0]
                timeout = 0.0
        except (EOFError, OSError):
            # It was killed.
            time.sleep(timeout)

    def tell(self, what: str) -> None:
        """Send it a word; one that has ended does not hear it."""
        with contextlib.suppress(OSError):
            self._pipe.send(what)

    def signal(self, number: signal.Signals) -> None:
        """Send the session a signal, but not its drivers."""
        _signal(self._process.pid, number)

    def kill_drivers(self) -> None:
        """End the drivers' processes at once (SIGKILL)."""
        for process in self._drivers:
            _signal(process, signal.SIGKILL)


def _signal(process: int | None, number: signal.Signals) -> None:
    # On a busy machine one may end by itself meanwhile.
    with contextlib.suppress(ProcessLookupError):
        if process is not None and _alive(process):
            os.kill(process, number)


def _alive(process: int | None) -> bool:
    """Whether a process runs; one that has ended and was not waited for does not."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in ("Z", "X")
