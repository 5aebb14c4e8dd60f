"""The process of one device: ``python -m fungrasp.robots.control_loop.loop_worker``.

Standard input carries the pickled loop and stays open: its end means that the driver's process has died,
and the device is halted at once.
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
    """Held from when a device is taken until its loop ends, however that ends."""

    def __init__(self, name: str):
        """name: type and address of the device."""
        self._name, self._file = name, -1

    def take(self) -> None:
        """Raises: RobotError: another program has the device."""
        if fcntl is None or self._file >= 0:
            return
        mark = hashlib.sha256(self._name.encode()).hexdigest()[:12]
        path = Path(tempfile.gettempdir()) / f"fungrasp-{mark}.lock"
        try:
            # Without O_CREAT first: systems refuse it for another user's file in a common folder.
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
        """Another program may have it. Never raises."""
        if self._file >= 0:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = -1


FOLLOWING = (LoopMode.IDLE, LoopMode.STAND_BY, LoopMode.FOLLOW)
BEYOND = 0.5
"""A joint that is measured so far beyond its limits is wrapped, or mounted otherwise [rad]: zeros are off by
less."""
HALTING = 10.0
"""A device that does not show that it has halted is told so again and again, for so long [s]."""
DRIVER_TIMEOUT = 0.5
"""A device holds its position when its driver was not asked for anything for so long [s]."""
RETRY = 0.05
"""Between two attempts at a device that is lost [s]."""


@dataclasses.dataclass(frozen=True)
class LoopTask:
    """What a process is to run."""

    loop: DeviceLoop
    """The device, not opened."""
    resume: str = ""
    """Why this loop takes the place of another one, which led the device; "" for a first one."""


def run_device_loop(
    task: LoopTask,
    goals: Mailbox[GoalMessage],
    reports: Mailbox[LoopReport],
    abandoned: Callable[[], bool] = lambda: False,
) -> None:
    """Open a device, step it until its driver closes it or goes away, then halt and close it.

    Args:
        goals: what the driver tells.
        reports: what it is told.
        abandoned: whether the driver's process has ended.
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
        # A driver must tell of whatever a client library raises: nobody else sees this thread or process.
        message, status = f"{loop.name}: {type(error).__name__}: {error}", DeviceStatus.FAULT
    run.end(status, message)
    # Last: a client library may take long to let go of a device that does not answer.
    loop.close()


class _Run:
    """A device's loop, and what it remembers."""

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
        """Open the device; one that another process led is ours at once."""
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
        """Step the device until it is to be closed."""
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
            # Most steps of a fast loop bring no news of the device: writing costs as much as all the rest.
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
        """One step of the device, which is looked for again where it was lost."""
        if not self._was_taken and goal.mode is not LoopMode.IDLE:
            # What we did not take we do not stop.
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
            # It may hear us though we don't hear it.
            self._loop.halt()
        self._loop.recover()  # pyright: ignore[reportAttributeAccessIssue]
        assert self._latched is not None
        message = f"{self._latched.message}; it answers again"
        self._latched = dataclasses.replace(self._latched, status=DeviceStatus.FAULT, message=message)
        self._lost = False

    def _said(self, state: JointState, mode: LoopMode, late: bool) -> JointState:
        """The state as the driver is told it."""
        if self._task.resume and self._latched is None and self._stopped_order < 0:
            self._latched = dataclasses.replace(state, status=DeviceStatus.FAULT, message=self._task.resume)
            self._stopped_order = self._order
        if self._latched is None and state.status is not DeviceStatus.READY:
            self._latched, self._stopped_order = state, self._order
        if self._latched is not None:
            latched = self._latched
            words = latched.message
            if not self._lost and state.status is DeviceStatus.FAULT and state.message not in words:
                # What is wrong besides, meanwhile.
                words = f"{words}; {state.message}"
            return dataclasses.replace(state, status=latched.status, message=words)
        if mode not in FOLLOWING:
            words = f"no command for {DRIVER_TIMEOUT} s" if late else f"told to stop: {mode.name.lower()}"
            return dataclasses.replace(state, status=DeviceStatus.STOPPED, message=words)
        return state

    def halt(self) -> None:
        """End motion, again and again until the device shows it; one that was only looked at is somebody
        else's."""
        deadline = time.monotonic() + HALTING
        while self._was_taken and self._loop.halt() is False and time.monotonic() < deadline:
            if self._told().goal.mode is LoopMode.ABANDON:
                break
            time.sleep(RETRY)
        self._lock.release()

    def end(self, status: DeviceStatus, message: str) -> None:
        """Tell that the loop has ended."""
        none = np.zeros(len(self._loop.limits.lower))
        last = self._state or JointState(none, none, None, 0.0, 0.0, status)
        self._tell(dataclasses.replace(last, status=status, message=message), ended=True)

    def _tell(self, state: JointState, ended: bool = False) -> None:
        if len(state.message) > MESSAGE:
            state = dataclasses.replace(state, message=state.message[:MESSAGE])
        self._reports.write(LoopReport(state, self._order, time.monotonic(), ended))


LENGTH = struct.Struct("<I")


def run_worker() -> None:
    """Run the loop that stands on standard input."""
    source = sys.stdin.buffer
    size = LENGTH.unpack(source.read(LENGTH.size))[0]
    # From the process that started this one, through its own pipe.
    task, descriptor = pickle.loads(source.read(size))
    orphaned = threading.Event()
    # Ahead of planning and all other work, client libraries' threads as well; systems allow it to
    # administrators. Linux shares the processors by sessions (autogroup of sched(7)), and this is one.
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, -5)
        Path("/proc/self/autogroup").write_text("-5")

    def watch() -> None:
        source.read()
        orphaned.set()
        # A client library may wait for ever for a device that went at the same moment, with our lock.
        time.sleep(2 * HALTING)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    # Ctrl-C in a terminal goes to both processes: the driver's decides how to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: orphaned.set())
    # A collection of all that was imported would take as long as many steps.
    gc.freeze()
    goals, reports = mailboxes(memoryview(mmap.mmap(descriptor, 2 * SIZE)))
    run_device_loop(task, goals, reports, orphaned.is_set)
    sys.stderr.flush()
    # All is said and written. Some client libraries wait in their destructors for devices that are gone.
    os._exit(0)


if __name__ == "__main__":
    run_worker()
