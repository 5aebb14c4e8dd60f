"""Drivers of robot hands, and their common parts."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from fungrasp.robots.control_loop.device_loop import ConfirmedWrites, DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError

OPEN_SPEED = 0.5
"""Speed of opening after a stop [rad/s]: full stroke in about 3 s, so that the object is not thrown."""


def hand_joint_limits(name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper limits of a hand's independent joints in model order [rad], shape [U] each.
    count: number of joints of the device. Raises: RobotError: the model has another number of joints."""
    # Imported here, as the process of a device must start fast and needs no model.
    from fungrasp.hands import load_hand

    hand = load_hand(name)
    if len(hand.actuators) != count:
        raise RobotError(
            f"hand '{hand.name}' has {len(hand.actuators)} independent joints, the device {count}"
        )
    lower, upper = np.array([hand.joint_limits[hand.joint_names.index(j)] for j in hand.actuators]).T
    return lower, upper


def next_setpoint(
    setpoint: np.ndarray | None, goal: LoopGoal, measured: np.ndarray, limits: JointLimits, step: float
) -> np.ndarray | None:
    """Return the next setpoint of a hand [rad], shape [U]; None if it has none.

    Args:
        setpoint: last setpoint [rad], shape [U]; None before the first.
        measured: measured joints, from which the first setpoint starts [rad], shape [U].
        step: time since the last setpoint [s].
    """
    if goal.mode is LoopMode.POWER_OFF:
        return None
    if setpoint is None:
        if goal.mode in (LoopMode.IDLE, LoopMode.STAND_BY):
            return None
        setpoint = np.clip(measured, limits.lower, limits.upper)
    wanted, largest = setpoint, limits.velocity * step
    if goal.mode is LoopMode.FOLLOW:
        wanted = goal.positions
    elif goal.mode is LoopMode.OPEN:
        # Zero, or the nearest position within the limits: an Allegro's thumb does not reach zero.
        wanted, largest = np.clip(np.zeros(len(measured)), limits.lower, limits.upper), OPEN_SPEED * step
    # Like ``np.clip``, in a third of its time.
    return setpoint + np.minimum(np.maximum(wanted - setpoint, -largest), largest)


class PolledHand(DeviceLoop):
    """Common part of hands that are read once a period and, under control, get commands each time."""

    def __init__(self, period: float, write: Callable[[str, Any], bool]):
        """period: time between two readings [s]; write: see ``ConfirmedWrites``."""
        self._period, self._writes = period, ConfirmedWrites(write)
        self._state: JointState | None = None
        self._taken, self._fault = False, ""
        self._due = self._errors_due = 0.0

    def step(self, goal: LoopGoal) -> JointState:
        rest = self._due - time.monotonic()
        if rest > 0:
            time.sleep(rest)
        self._due = max(self._due, time.monotonic() - self._period) + self._period
        if goal.mode is LoopMode.IDLE and self._fault:
            # The driver has connected again after a fault.
            self._acknowledge()
            self._fault, self._errors_due = "", 0.0
        before = self._state
        state = self._read_state() or before
        if state is None or time.monotonic() - state.received > self.stale_after:
            raise RobotError(f"{self.name}: no positions for {1e3 * self.stale_after:.0f} ms")
        if not self._taken:
            return state
        self._move(goal, state, state.received - before.received if before else self._period)
        if refused := self._writes.work():
            return replace(state, status=DeviceStatus.FAULT, message=state.message or refused)
        return state

    def _acknowledge(self) -> None:
        """Clear a fault in the hand."""

    @abstractmethod
    def _read_state(self) -> JointState | None:
        """Read the state and keep it as ``_state``; None without an answer, or for an implausible one."""

    @abstractmethod
    def _move(self, goal: LoopGoal, state: JointState, elapsed: float) -> None:
        """Send commands for the goal. elapsed: time between the last two states [s]."""
