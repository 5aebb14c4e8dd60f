"""A device whose client library waits for ever once it is told to move."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np

from fungrasp.robots.control_loop.device_loop import DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState


class HangingLoop(DeviceLoop):
    """One joint."""

    stale_after = 1.0

    def __init__(self, name: str, hangs: Path, halting: float):
        """hangs: file that is made as it begins to hang; halting: in place of the worker's ``HALTING``."""
        self.name, self._hangs, self._halting = name, hangs, halting
        self.limits = JointLimits(-np.ones(1), np.ones(1), np.ones(1), np.ones(1))

    def open(self) -> None:
        """The worker's module is the main one of its process."""
        vars(sys.modules["__main__"])["HALTING"] = self._halting

    def take_control(self) -> None: ...

    def step(self, goal: LoopGoal) -> JointState:
        if goal.mode is LoopMode.FOLLOW:
            self._hangs.touch()
            threading.Event().wait()
        time.sleep(0.01)
        now = time.monotonic()
        return JointState(np.zeros(1), np.zeros(1), None, now, now, DeviceStatus.READY)

    def halt(self) -> None: ...

    def close(self) -> None: ...
