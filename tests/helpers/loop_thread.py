"""A device's loop in a thread of the test's process: it begins at once, and finds buses that live in it."""

from __future__ import annotations

import pickle
import threading

from fungrasp.robots.control_loop.loop_worker import LoopTask, run_device_loop
from fungrasp.robots.control_loop.mailbox import SIZE, GoalMessage, mailboxes


class LoopThread:
    """In place of ``LoopProcess``."""

    def __init__(self, task: LoopTask, goal: GoalMessage):
        """goal: the first."""
        self.goals, self.reports = mailboxes(memoryview(bytearray(2 * SIZE)))
        self.goals.write(goal)
        # A copy, as a process would get one: a loop is opened once.
        arguments = (pickle.loads(pickle.dumps(task)), self.goals, self.reports)
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
