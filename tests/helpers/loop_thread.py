"""A device's loop in a thread of the test's process: it begins at once, and finds buses that live in it."""

from __future__ import annotations

import pickle
import threading

import numpy as np

from fungrasp.robots.control_loop.loop_worker import LoopTask, run_device_loop
from fungrasp.robots.control_loop.mailbox import Mailbox, goal_kind, mailbox_size, state_kind


class LoopThread:
    """In place of ``LoopProcess``."""

    def __init__(self, task: LoopTask, goal: np.ndarray):
        """goal: the first, a record of ``goal_kind``."""
        count = len(task.loop.limits.lower)
        self.goals = Mailbox(memoryview(bytearray(mailbox_size(goal_kind(count)))), goal_kind(count))
        self.states = Mailbox(memoryview(bytearray(mailbox_size(state_kind(count)))), state_kind(count))
        self.goals.write(goal)
        # A copy, as a process would get one: a loop is opened once.
        arguments = (pickle.loads(pickle.dumps(task)), self.goals, self.states)
        self._thread = threading.Thread(
            target=run_device_loop, args=arguments, daemon=True, name=task.loop.name
        )
        self._thread.start()

    def alive(self) -> bool:
        """Whether it runs."""
        return self._thread.is_alive()

    def last_words(self) -> str:
        """A thread's errors are in its last state."""
        return ""

    def end(self, patience: float) -> bool:
        """Wait for its end, after it was told to. patience: for so long [s]. Returns: whether it ended."""
        self._thread.join(patience)
        return not self._thread.is_alive()

    def kill(self) -> None:
        """A thread can't be ended: it ends once it reads ``LoopMode.ABANDON``."""
