"""Where a device's loop runs beside its driver: a process, or a thread."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading

import numpy as np

from fungrasp.robots.control_loop.device_loop import DeviceLoop
from fungrasp.robots.control_loop.loop_worker import LENGTH, run_device_loop
from fungrasp.robots.control_loop.mailbox import (
    Mailbox,
    SharedMemoryFile,
    goal_kind,
    mailbox_size,
    state_kind,
)


def worker_environment() -> dict[str, str]:
    """Those of this process, so that a Python process finds the packages that this one finds, and computes in
    one thread: more would take the time of others."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }


class LoopThread:
    """A device's loop in a thread of this process."""

    def __init__(self, loop: DeviceLoop, goal: np.ndarray, driver_timeout: float):
        """
        Args:
            loop: the device, not opened.
            goal: the first, a record of ``goal_kind``.
            driver_timeout: see ``run_device_loop`` [s].
        """
        count = len(loop.limits.lower)
        self.goals = Mailbox(memoryview(bytearray(mailbox_size(goal_kind(count)))), goal_kind(count))
        self.states = Mailbox(memoryview(bytearray(mailbox_size(state_kind(count)))), state_kind(count))
        self.goals.write(goal)
        # A copy, as a process would get one: a loop is opened once.
        copy = pickle.loads(pickle.dumps(loop))
        arguments = (copy, self.goals, self.states, driver_timeout)
        self._thread = threading.Thread(target=run_device_loop, args=arguments, daemon=True, name=loop.name)
        self._thread.start()

    def alive(self) -> bool:
        """Whether it runs."""
        return self._thread.is_alive()

    def last_words(self) -> str:
        """Nothing: a thread's errors are in its last state."""
        return ""

    def end(self, patience: float) -> None:
        """Wait for its end, after it was told to. patience: for so long [s]."""
        self._thread.join(patience)


class LoopProcess:
    """A device's loop in a process of its own, which ends when this one does."""

    def __init__(self, loop: DeviceLoop, goal: np.ndarray, driver_timeout: float):
        """
        Args:
            loop: the device, not opened.
            goal: the first, a record of ``goal_kind``.
            driver_timeout: see ``run_device_loop`` [s].
        """
        count = len(loop.limits.lower)
        first = mailbox_size(goal_kind(count))
        self._memory = SharedMemoryFile(first + mailbox_size(state_kind(count)))
        view = memoryview(self._memory.buffer)
        self.goals = Mailbox(view[:first], goal_kind(count))
        self.states = Mailbox(view[first:], state_kind(count))
        self.goals.write(goal)
        self._child = subprocess.Popen(
            [sys.executable, "-m", "fungrasp.robots.control_loop.loop_worker"],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env=worker_environment(),
            start_new_session=True,
        )
        self._errors: list[str] = []
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()
        data = pickle.dumps((loop, str(self._memory.path), driver_timeout))
        assert self._child.stdin is not None
        # Where it has ended already, who waits for its first state will see so.
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.write(LENGTH.pack(len(data)) + data)
            self._child.stdin.flush()

    @property
    def process_id(self) -> int:
        """Of the system."""
        return self._child.pid

    def alive(self) -> bool:
        """Whether it runs."""
        return self._child.poll() is None

    def last_words(self) -> str:
        """The last line that the process wrote to standard error."""
        self._reader.join(0.2)
        return f": {self._errors[-1]}" if self._errors else ""

    def end(self, patience: float) -> None:
        """Wait for its end, after it was told to. patience: for so long [s]."""
        assert self._child.stdin is not None
        try:
            self._child.wait(patience)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.close()
        self._memory.remove()

    def _collect(self) -> None:
        assert self._child.stderr is not None
        for line in self._child.stderr:
            text = line.decode(errors="replace").strip()
            if text:
                self._errors = [*self._errors[-19:], text]
