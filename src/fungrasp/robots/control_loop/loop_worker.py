"""The process of one device: ``python -m fungrasp.robots.control_loop.loop_worker``.

Standard input carries the pickled task and stays open. When it ends, the driver's process has died, and the
device is halted at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import hashlib
import mmap
import os
import pickle
import signal
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.robots.control_loop.device_loop import DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.control_loop.mailbox import MESSAGE, SIZE, GoalMessage, LoopReport, Mailbox, mailboxes
from fungrasp.robots.device import DeviceStatus, JointState, RobotError

try:
    import fcntl
except ImportError:  # Windows has no such locks.
    fcntl = None


class DeviceLock:
    """Lock of a device among the programs on this computer; it ends with the process at the latest."""

    def __init__(self, name: str):
        """name: type and address of the device."""
        self._name, self._file = name, -1

    def take(self) -> None:
        """Lock the device. Raises: RobotError: another program has locked it."""
        if fcntl is None or self._file >= 0:
            return
        mark = hashlib.sha256(self._name.encode()).hexdigest()[:12]
        path = Path(tempfile.gettempdir()) / f"fungrasp-{mark}.lock"
        try:
            # Systems refuse O_CREAT for another user's file in a shared folder.
            exists = path.exists()
            file = os.open(path, os.O_RDONLY if exists else os.O_RDONLY | os.O_CREAT, 0o644)
        except OSError as error:
            raise RobotError(f"cannot lock {self._name}: {path}: {error.strerror}") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            raise RobotError(
                f"{self._name} is moved by another program on this computer: end that one first"
            ) from None
        self._file = file

    def release(self) -> None:
        """Unlock the device. Never raises."""
        if self._file >= 0:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = -1


FOLLOWING = (LoopMode.IDLE, LoopMode.STAND_BY, LoopMode.FOLLOW)
BEYOND = 0.5
"""Distance of a reading beyond the limits that means a wrapped or differently mounted joint [rad]; zeros are
off by less."""
HALTING = 10.0
"""Time in which a device is halted repeatedly until it confirms [s]."""
DRIVER_TIMEOUT = 0.5
"""Time without use of its driver after which a device holds its position [s]."""
RETRY = 0.05
"""Time between two attempts to reach a lost device [s]."""


@dataclasses.dataclass(frozen=True)
class LoopTask:
    """Task of a loop's process."""

    loop: DeviceLoop
    """Loop of the device, not opened."""
    resume: str = ""
    """Why this loop replaces another one that controlled the device; "" for the first loop."""


def run_device_loop(
    task: LoopTask,
    goals: Mailbox[GoalMessage],
    reports: Mailbox[LoopReport],
    abandoned: Callable[[], bool] = lambda: False,
) -> None:
    """Open a device, step it until its driver closes it or dies, then halt and close it.

    Args:
        goals: goals from the driver.
        reports: reports to the driver.
        abandoned: returns whether the driver's process has ended.
    """
    loop = task.loop
    run = _Run(task, goals, reports, abandoned)
    try:
        try:
            run.open()
            run.follow()
        finally:
            run.halt()
        message, status = "", DeviceStatus.DISCONNECTED
    except FungraspError as error:
        message, status = str(error), DeviceStatus.DISCONNECTED
    except Exception as error:
        # Client libraries may raise anything, and only the driver can report it.
        message, status = f"{loop.name}: {type(error).__name__}: {error}", DeviceStatus.FAULT
    run.end(status, message)
    # Last, as a client library may take long to close a device that does not answer.
    loop.close()


class _Run:
    """A running loop and its state."""

    def __init__(
        self,
        task: LoopTask,
        goals: Mailbox[GoalMessage],
        reports: Mailbox[LoopReport],
        abandoned: Callable[[], bool],
    ) -> None:
        self._task, self._loop, self._goals, self._reports = task, task.loop, goals, reports
        self._abandoned, self._lock = abandoned, DeviceLock(task.loop.name)
        self._taken = self._was_taken = self._lost = False
        self._latched: JointState | None = None
        self._stopped_order, self._order = -1, -1
        self._state: JointState | None = None

    def open(self) -> None:
        """Open the device; if another process controlled it, take it over at once."""
        deadline = time.monotonic() + HALTING
        while True:
            try:
                self._loop.open()
                break
            except FungraspError:
                if not self._task.resume or self._abandoned() or time.monotonic() > deadline:
                    raise
                self._loop.close()
                time.sleep(RETRY)
        if self._task.resume:
            self._lock.take()
            self._loop.resume(self._told().goal.positions)  # pyright: ignore[reportAttributeAccessIssue]
            self._taken = self._was_taken = True

    def follow(self) -> None:
        """Step the device until its driver closes it or dies."""
        last = None
        while not self._abandoned():
            told = self._told()
            news, last, self._order, goal = told is not last, told, told.order, told.goal
            if goal.mode in (LoopMode.CLOSE, LoopMode.ABANDON):
                return
            if self._order > self._stopped_order >= 0 and goal.mode is LoopMode.IDLE and not self._lost:
                self._latched = None
            if self._latched is not None and goal.mode in FOLLOWING:
                goal = dataclasses.replace(goal, mode=LoopMode.HOLD)
            late = goal.mode is LoopMode.FOLLOW and time.monotonic() - told.sent > DRIVER_TIMEOUT
            if late:
                goal = dataclasses.replace(goal, mode=LoopMode.HOLD)
            if goal.mode is LoopMode.IDLE:
                self._taken = False
            elif goal.mode in FOLLOWING and not self._taken:
                self._take_control()
            state = self._said(self._step(goal), goal.mode, late)
            # Most steps of a fast loop bring no new state, and writing takes as long as all the rest.
            if state is not self._state or news:
                self._tell(state)
                self._state = state

    def _told(self) -> GoalMessage:
        told = self._goals.read()
        assert told is not None, "the driver writes a goal before it starts the loop"
        return told

    def _take_control(self) -> None:
        self._lock.take()
        seen = self._state
        if seen is None:
            none = np.zeros(len(self._loop.limits.lower))
            seen = self._loop.step(LoopGoal(LoopMode.IDLE, none, none))
        limits = self._loop.limits
        beyond = np.maximum(limits.lower - seen.positions, seen.positions - limits.upper)
        joint = int(np.argmax(beyond))
        if not beyond[joint] <= BEYOND:
            raise RobotError(
                f"{self._loop.name}: joint {joint} is read at {seen.positions[joint]:.2f} rad, and its limits"
                f" are {limits.lower[joint]:.2f} to {limits.upper[joint]:.2f} rad: look at it with 'fungrasp "
                "robots read', then switch it off and on"
            )
        self._was_taken = True
        self._loop.take_control()
        self._taken = True

    def _step(self, goal: LoopGoal) -> JointState:
        """Make one step of the device; reconnect to it first if it was lost."""
        if not self._was_taken and goal.mode is not LoopMode.IDLE:
            # A device that was not taken over must not be stopped.
            goal = dataclasses.replace(goal, mode=LoopMode.IDLE)
        try:
            if self._lost:
                self._recover(goal)
            return self._loop.step(goal)
        except RobotError as error:
            seen = self._latched or self._state
            if seen is None or not (self._was_taken and hasattr(self._loop, "recover")):
                raise
            if not self._lost:
                self._lost, status = True, DeviceStatus.DISCONNECTED
                self._latched = dataclasses.replace(seen, status=status, message=str(error))
                self._stopped_order = self._order
            else:
                time.sleep(RETRY)
            assert self._latched is not None
            return self._latched

    def _recover(self, goal: LoopGoal) -> None:
        if goal.mode is LoopMode.POWER_OFF:
            # The device may receive this even if its answers are lost.
            self._loop.halt()
        self._loop.recover()  # pyright: ignore[reportAttributeAccessIssue]
        assert self._latched is not None
        message = f"{self._latched.message}; it answers again"
        self._latched = dataclasses.replace(self._latched, status=DeviceStatus.FAULT, message=message)
        self._lost = False

    def _said(self, state: JointState, mode: LoopMode, late: bool) -> JointState:
        """Return the state to report to the driver: a latched fault or stop, if there is one."""
        if self._task.resume and self._latched is None and self._stopped_order < 0:
            self._latched = dataclasses.replace(state, status=DeviceStatus.FAULT, message=self._task.resume)
            self._stopped_order = self._order
        if self._latched is None and state.status is not DeviceStatus.READY:
            self._latched, self._stopped_order = state, self._order
        if self._latched is not None:
            latched = self._latched
            words = latched.message
            if not self._lost and state.status is DeviceStatus.FAULT and state.message not in words:
                words = f"{words}; {state.message}"
            return dataclasses.replace(state, status=latched.status, message=words)
        if mode not in FOLLOWING:
            words = f"no command for {DRIVER_TIMEOUT} s" if late else f"told to stop: {mode.name.lower()}"
            return dataclasses.replace(state, status=DeviceStatus.STOPPED, message=words)
        return state

    def halt(self) -> None:
        """End motion repeatedly until the device confirms it; a device that was only read is left alone."""
        deadline = time.monotonic() + HALTING
        while self._was_taken and self._loop.halt() is False and time.monotonic() < deadline:
            if self._told().goal.mode is LoopMode.ABANDON:
                break
            time.sleep(RETRY)
        self._lock.release()

    def end(self, status: DeviceStatus, message: str) -> None:
        """Report that the loop has ended."""
        none = np.zeros(len(self._loop.limits.lower))
        last = self._state or JointState(none, none, None, 0.0, 0.0, status)
        self._tell(dataclasses.replace(last, status=status, message=message), ended=True)

    def _tell(self, state: JointState, ended: bool = False) -> None:
        if len(state.message) > MESSAGE:
            state = dataclasses.replace(state, message=state.message[:MESSAGE])
        self._reports.write(LoopReport(state, self._order, time.monotonic(), ended))


LENGTH = struct.Struct("<I")


def run_worker() -> None:
    """Run the task from standard input."""
    source = sys.stdin.buffer
    size = LENGTH.unpack(source.read(LENGTH.size))[0]
    # Safe to unpickle: the parent process writes it through its own pipe.
    task, descriptor = pickle.loads(source.read(size))
    orphaned = threading.Event()
    # Priority over planning and all other work, if the system permits it. Linux shares the processors among
    # sessions (autogroup, sched(7)), and this process is one.
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, -5)
        Path("/proc/self/autogroup").write_text("-5")

    def watch() -> None:
        source.read()
        orphaned.set()
        # A client library may wait forever for a device that is gone, and keep the lock.
        time.sleep(2 * HALTING)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    # The driver's process decides how Ctrl-C stops the device.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: orphaned.set())
    # Garbage collection of all imported objects would take as long as many steps.
    gc.freeze()
    goals, reports = mailboxes(memoryview(mmap.mmap(descriptor, 2 * SIZE)))
    run_device_loop(task, goals, reports, orphaned.is_set)
    sys.stderr.flush()
    # Destructors of some client libraries wait for devices that are gone.
    os._exit(0)


if __name__ == "__main__":
    run_worker()
