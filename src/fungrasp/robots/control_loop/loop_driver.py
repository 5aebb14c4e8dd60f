"""A driver that sends goals to the control loop of a device in a separate process, and reads its states."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fungrasp.core.parallel import worker_environment
from fungrasp.robots.control_loop.device_loop import DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.control_loop.loop_worker import FOLLOWING, LENGTH, LoopTask
from fungrasp.robots.control_loop.mailbox import GoalMessage, LoopReport, mailboxes, shared_memory
from fungrasp.robots.device import DeviceStatus, JointDriver, JointLimits, JointState, RobotError, StopKind

_log = logging.getLogger(__name__)


class LoopProcess:
    """A separate process with the loop of a device; it ends with this process."""

    def __init__(self, task: LoopTask, goal: GoalMessage):
        """goal: the first goal."""
        descriptor, memory = shared_memory()
        self.goals, self.reports = mailboxes(memory)
        self.goals.write(goal)
        self._child = subprocess.Popen(
            [sys.executable, "-m", "fungrasp.robots.control_loop.loop_worker"],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env=worker_environment(),
            start_new_session=True,
            pass_fds=(descriptor,),
        )
        os.close(descriptor)
        self._errors: list[str] = []
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()
        data = pickle.dumps((task, descriptor))
        assert self._child.stdin is not None
        # If the process has ended already, the driver notices while it waits for the first state.
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.write(LENGTH.pack(len(data)) + data)
            self._child.stdin.flush()

    @property
    def process_id(self) -> int:
        """Process ID."""
        return self._child.pid

    def alive(self) -> bool:
        """Return whether the process runs."""
        return self._child.poll() is None

    def last_words(self) -> str:
        """Return the last line that the process wrote to standard error, after a colon."""
        self._reader.join(0.2)
        return f": {self._errors[-1]}" if self._errors else ""

    def end(self, patience: float) -> bool:
        """Wait until the process ends. patience: longest wait [s]. Returns: whether it ended."""
        assert self._child.stdin is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(patience)
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.close()
        return not self.alive()

    def kill(self) -> None:
        """Kill the process."""
        self._child.kill()
        self._child.wait()

    def _collect(self) -> None:
        assert self._child.stderr is not None
        for line in self._child.stderr:
            text = line.decode(errors="replace").strip()
            if text:
                self._errors = [*self._errors[-19:], text]


CONNECT_TIMEOUT = 15.0
"""Longest wait for a device to connect [s]; a UR controller starts a program in seconds."""
CLOSE_TIMEOUT = 3.0
"""Longest wait for a loop to end [s]; a loop that takes longer waits for its device to confirm the halt."""
LOST_TIMEOUT = 0.5
"""Longest wait for the loop of a lost device to end [s]."""
FROZEN = 2.0
"""Time without reports after which a loop's process hangs [s]."""


class LoopDriver(JointDriver):
    """``JointDriver`` of a ``DeviceLoop`` in a separate process, which halts the device if this process dies.
    A loop with ``resume`` moves to a new process if its own dies or hangs, and the device holds."""

    def __init__(self, loop: DeviceLoop, host: Callable[[LoopTask, GoalMessage], Any] = LoopProcess):
        """
        Args:
            loop: loop of the device, not opened.
            host: class that runs the loop, with the interface of ``LoopProcess``.
        """
        self.name = loop.name
        self.takes_feedforward = loop.takes_feedforward
        self.lets_go = loop.lets_go
        self.limits: JointLimits = loop.limits
        self._loop = loop
        self._make_host = host
        self._count = len(loop.limits.lower)
        self._lock = threading.Lock()
        self._host: Any = None
        self._nothing = np.zeros(self._count)
        self._goal, self._order = LoopGoal(LoopMode.IDLE, self._nothing, self._nothing), 0
        self._stopped: str | None = None
        self._controls = self._was_taken = False
        self._beat, self._heard, self._asked = -1.0, 0.0, 0.0
        self._replaces = ""

    def torque_limit(self, share: float) -> None:
        """Limit the device to a share of its torque, before connecting; no effect for a loop without
        ``torque_limit``, which returns a limited loop. share: above 0, at most 1. Raises: RobotError: an
        invalid share."""
        if not 0 < share <= 1:
            raise RobotError(f"a share of the torque is above 0 and at most 1, not {share:g}")
        limited = getattr(self._loop, "torque_limit", None)
        if limited is not None and share < 1:
            self._loop = limited(share)
            self.limits = self._loop.limits

    def connect(self) -> None:
        """See ``JointDriver.connect``. For a connected device, this acknowledges a stop."""
        with self._lock:
            lost = self._host is None or self._ended() or self._read().status is DeviceStatus.DISCONNECTED
            if not lost:
                self._tell(LoopMode.IDLE)
                self._await_acknowledgement()
            else:
                # The loop may wait in a client library for a device that is gone.
                self._end(LOST_TIMEOUT, replaced=True)
                self._start()
            self._stopped, self._controls, self._replaces = None, False, ""

    def take_control(self) -> None:
        with self._lock:
            self._check_ready()
            self._take_control()

    def read(self) -> JointState:
        """See ``JointDriver.read``. A state older than ``stale_after`` has the status DISCONNECTED."""
        with self._lock:
            return self._read()

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        positions = np.asarray(positions, dtype=float)
        torques = self._nothing if feedforward is None else np.asarray(feedforward, dtype=float)
        for what, values in (("goal", positions), ("feed-forward torque", torques)):
            if values.shape != (self._count,):
                raise RobotError(f"{self.name}: the {what} has shape {values.shape}, not ({self._count},)")
            if not np.isfinite(values).all():
                joint = int(np.flatnonzero(~np.isfinite(values))[0])
                raise RobotError(f"{self.name}: the {what} of joint {joint} is not finite")
        with self._lock:
            self._check_ready()
            self._take_control()
            sent = np.clip(positions, self.limits.lower, self.limits.upper)
            torques = np.clip(torques, -self.limits.torque, self.limits.torque)
            self._goal = LoopGoal(LoopMode.FOLLOW, sent, torques)
            self._tell(LoopMode.FOLLOW)
        return sent

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        with self._lock:
            self._stopped = kind.value
            if self._host is not None:
                self._tell(LoopMode[kind.name])

    def close(self) -> None:
        with self._lock:
            self._end()

    @property
    def process_id(self) -> int | None:
        """Process ID of the device's loop; None if not connected."""
        return getattr(self._host, "process_id", None)

    def _check_ready(self) -> None:
        state = self._read()
        if self._stopped is not None:
            raise RobotError(f"{self.name} was stopped ({self._stopped}): call connect() first")
        # The device may hold only because this driver was not used for a while.
        waits = state.status is DeviceStatus.STOPPED and self._goal.mode in FOLLOWING
        if state.status is not DeviceStatus.READY and not waits:
            raise RobotError(f"{self.name} takes no command, {state.status}: {state.message}")

    def _take_control(self) -> None:
        if not self._controls:
            self._was_taken = True
            self._tell(LoopMode.STAND_BY)
            self._await_acknowledgement()
            self._controls = True

    def _start(self) -> None:
        self._was_taken, self._replaces = False, ""
        self._goal = dataclasses.replace(self._goal, mode=LoopMode.IDLE)
        self._host = self._make_host(LoopTask(self._loop), self._message())
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while time.monotonic() < deadline:
            report = self._report
            if report is not None:
                if not report.ended:
                    return
                self._end()
                raise RobotError(report.state.message)
            if not self._host.alive() and self._report is None:
                message = self._host.last_words()
                self._end()
                raise RobotError(f"{self.name}: the driver's process ended while connecting{message}")
            time.sleep(0.002)
        self._end()
        raise RobotError(f"{self.name} did not answer within {CONNECT_TIMEOUT:.0f} s")

    def _await_acknowledgement(self) -> None:
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while time.monotonic() < deadline:
            report = self._report
            if (report is not None and report.order >= self._order) or self._ended():
                # Read only now, as the loop may have refused and ended meanwhile.
                state = self._read()
                if state.status is not DeviceStatus.READY:
                    raise RobotError(f"{self.name} is not ready, {state.status}: {state.message}")
                return
            time.sleep(0.001)
        raise RobotError(f"{self.name} does not answer")

    @property
    def _report(self) -> LoopReport | None:
        """Newest report of the loop."""
        return None if self._host is None else self._host.reports.read()

    def _message(self) -> GoalMessage:
        return GoalMessage(self._goal, self._order, time.monotonic())

    def _tell(self, mode: LoopMode) -> None:
        self._goal = dataclasses.replace(self._goal, mode=mode)
        self._order += 1
        self._host.goals.write(self._message())

    def _read(self) -> JointState:
        report, now = self._report, time.monotonic()
        if report is None:
            none = self._nothing
            return JointState(none, none, None, 0.0, now, DeviceStatus.DISCONNECTED, "not connected")
        self._host.goals.write(self._message())
        state = report.state
        if report.ended:
            return state
        if not self._host.alive():
            return self._replaced(state, f"the driver's process has ended{self._host.last_words()}")
        if self._frozen(report.beat, now):
            return self._replaced(state, f"the driver's process did nothing for {FROZEN:g} s")
        late = now - state.received > self._loop.stale_after
        if late and state.status in (DeviceStatus.READY, DeviceStatus.STOPPED):
            message = f"no new state for more than {1e3 * self._loop.stale_after:.0f} ms"
            return dataclasses.replace(state, status=DeviceStatus.DISCONNECTED, message=message)
        return state

    def _frozen(self, beat: float, now: float) -> bool:
        """Return whether the loop's process hangs. Pauses of this process do not count, as both may sleep."""
        watched = min(now - self._asked, 0.2)
        self._asked = now
        self._heard = 0.0 if beat != self._beat else self._heard + watched
        self._beat = beat
        return self._heard > FROZEN and self._was_taken and isinstance(self._host, LoopProcess)

    def _replaced(self, state: JointState, why: str) -> JointState:
        """Let another process control the device, if its loop has ``resume``; return the state meanwhile."""
        if self._was_taken and hasattr(self._loop, "resume") and not self._replaces:
            self._host.end(0.0)
            self._host.kill()
            if self._goal.mode in FOLLOWING:
                self._goal = dataclasses.replace(self._goal, mode=LoopMode.HOLD)
            self._replaces, self._heard = f"{why}; another process controls the device now", 0.0
            self._host = LoopProcess(LoopTask(self._loop, self._replaces), self._message())
            # Valid until the new process reports.
            lost = dataclasses.replace(state, status=DeviceStatus.DISCONNECTED, message=self._replaces)
            self._host.reports.write(LoopReport(lost, -1, 0.0))
        return dataclasses.replace(state, status=DeviceStatus.DISCONNECTED, message=self._replaces or why)

    def _ended(self) -> bool:
        report = self._report
        return not self._host.alive() or (report is not None and report.ended)

    def _end(self, patience: float = CLOSE_TIMEOUT, replaced: bool = False) -> None:
        if self._host is None:
            return
        self._tell(LoopMode.CLOSE)
        if not self._host.end(patience):
            if replaced or not self._was_taken:
                self._tell(LoopMode.ABANDON)
                self._host.kill()
            else:
                # The process goes on halting the device for a while (``HALTING``).
                _log.warning("%s has not confirmed that it stopped: it may still have torque", self.name)
        self._host = None
