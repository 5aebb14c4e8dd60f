"""The process of one device: ``python -m fungrasp.robots.control_loop.loop_worker``.

Standard input carries the pickled loop and stays open: its end means that the driver's process has died,
and the device is halted at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
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
from fungrasp.robots.control_loop.mailbox import (
    ENDED,
    RUNNING,
    STATUSES,
    Mailbox,
    goal_kind,
    loop_goal,
    mailbox_size,
    map_shared_memory,
    put_state,
    state_kind,
)
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


def run_device_loop(
    loop: DeviceLoop,
    goals: Mailbox,
    states: Mailbox,
    driver_timeout: float,
    abandoned: Callable[[], bool] = lambda: False,
) -> None:
    """Open a device, step it until its driver closes it or goes away, then halt and close it.

    Args:
        goals: what the driver tells, records of ``goal_kind``.
        states: what the device answers, records of ``state_kind``.
        driver_timeout: the device holds its position when the driver was not heard of for so long [s].
        abandoned: whether the driver's process has ended.
    """
    count = len(loop.limits.lower)
    record = np.zeros((), dtype=state_kind(count))
    control = _Control(DeviceLock(loop.name))
    try:
        try:
            loop.open()
            _follow(loop, goals, states, record, driver_timeout, abandoned, control)
        finally:
            # A device that was only looked at is somebody else's.
            if control.was_taken:
                loop.halt()
            control.lock.release()
        message, status = "", DeviceStatus.DISCONNECTED
    except FungraspError as error:
        message, status = str(error), DeviceStatus.DISCONNECTED
    except Exception as error:
        # A driver must tell of whatever a client library raises: nobody else sees this thread or process.
        message, status = f"{loop.name}: {type(error).__name__}: {error}", DeviceStatus.FAULT
    record["phase"], record["status"], record["message"] = ENDED, STATUSES.index(status), message.encode()
    states.write(record)
    # Last: a client library may take long to let go of a device that does not answer.
    loop.close()


@dataclasses.dataclass
class _Control:
    """Whether the device is ours."""

    lock: DeviceLock
    taken: bool = False
    was_taken: bool = False


def _follow(
    loop: DeviceLoop,
    goals: Mailbox,
    states: Mailbox,
    record: np.ndarray,
    driver_timeout: float,
    abandoned: Callable[[], bool],
    control: _Control,
) -> None:
    latched: JointState | None = None
    stopped_order, order, told_last, state_last = -1, -1, None, None
    asked, sent = LoopGoal(LoopMode.IDLE, np.zeros(0), np.zeros(0)), 0.0
    record["phase"] = RUNNING
    while not abandoned():
        told = goals.read()
        assert told is not None, "the driver writes a goal before it starts the loop"
        news = told is not told_last
        if news:
            told_last, asked, order, sent = told, loop_goal(told), int(told["order"]), float(told["sent"])
        goal = asked
        if goal.mode is LoopMode.CLOSE:
            return
        if latched is not None and order > stopped_order >= 0 and goal.mode is LoopMode.IDLE:
            latched = None
        if latched is not None and goal.mode in FOLLOWING:
            goal = dataclasses.replace(goal, mode=LoopMode.HOLD)
        late = goal.mode is LoopMode.FOLLOW and time.monotonic() - sent > driver_timeout
        if late:
            goal = dataclasses.replace(goal, mode=LoopMode.HOLD)
        wanted = goal.mode
        if wanted is LoopMode.IDLE:
            control.taken = False
        elif wanted in FOLLOWING and not control.taken:
            control.lock.take()
            control.was_taken = True
            loop.take_control()
            control.taken = True
        if not control.was_taken and wanted is not LoopMode.IDLE:
            # What we did not take we do not stop.
            goal = dataclasses.replace(goal, mode=LoopMode.IDLE)
        state = loop.step(goal)
        if latched is None and state.status is not DeviceStatus.READY:
            latched, stopped_order = state, order
        if latched is not None:
            state = dataclasses.replace(state, status=latched.status, message=latched.message)
        elif wanted not in FOLLOWING:
            message = f"no command for {driver_timeout} s" if late else f"told to stop: {wanted.name.lower()}"
            state = dataclasses.replace(state, status=DeviceStatus.STOPPED, message=message)
        # Most steps of a fast loop bring no news of the device: writing costs as much as all the rest.
        if state is not state_last or news:
            put_state(record, state)
            record["order"] = order
            states.write(record)
            state_last = state


LENGTH = struct.Struct("<I")


def run_worker() -> None:
    """Run the loop that stands on standard input."""
    source = sys.stdin.buffer
    size = LENGTH.unpack(source.read(LENGTH.size))[0]
    # From the process that started this one, through its own pipe.
    loop, path, driver_timeout = pickle.loads(source.read(size))
    orphaned = threading.Event()
    # Ahead of planning and all other work, client libraries' threads as well; systems allow it to
    # administrators. Linux shares the processors by sessions (autogroup of sched(7)), and this is one.
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, -5)
        Path("/proc/self/autogroup").write_text("-5")

    def watch() -> None:
        source.read()
        orphaned.set()

    threading.Thread(target=watch, daemon=True).start()
    # Ctrl-C in a terminal goes to both processes: the driver's decides how to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: orphaned.set())
    memory = memoryview(map_shared_memory(Path(path)))
    count = len(loop.limits.lower)
    first = mailbox_size(goal_kind(count))
    goals = Mailbox(memory[:first], goal_kind(count))
    states = Mailbox(memory[first:], state_kind(count))
    run_device_loop(loop, goals, states, driver_timeout, orphaned.is_set)
    sys.stderr.flush()
    # All is said and written. Some client libraries wait in their destructors for devices that are gone.
    os._exit(0)


if __name__ == "__main__":
    run_worker()
