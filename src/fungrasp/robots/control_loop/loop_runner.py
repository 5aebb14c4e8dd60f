"""Runs the loop of a device on goals from a mailbox until it is told to end."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.robots.control_loop.device_lock import DeviceLock
from fungrasp.robots.control_loop.device_loop import DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.control_loop.mailbox import Mailbox
from fungrasp.robots.control_loop.records import ENDED, RUNNING, STATUSES, loop_goal, put_state, state_kind
from fungrasp.robots.device import DeviceStatus, JointState

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
        loop: the device.
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
        state = _step(loop, goal, record)
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


def _step(loop: DeviceLoop, goal: LoopGoal, record: np.ndarray) -> JointState:
    before = time.thread_time()
    state = loop.step(goal)
    record["busy"] += time.thread_time() - before
    record["steps"] += 1
    return state
