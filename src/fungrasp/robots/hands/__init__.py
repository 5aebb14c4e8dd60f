"""Drivers of robot hands, and what they take from the hand's model."""

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
"""Of opening after a fault [rad/s]: full stroke in about 3 s, so that an object is let go, not thrown."""


def hand_joint_limits(name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest positions of a hand's independent joints [rad], shape [U] each, in model order: the
    order of drivers. count: of joints that the device has. Raises: RobotError: the model has another number
    of joints."""
    # Here, because the process of a device must start fast and needs no model.
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
    """Setpoint of a hand that is led by setpoints, a step later [rad], shape [U]; None where it has none.

    Args:
        setpoint: the last one [rad], shape [U]; None for none.
        measured: joint positions, where the first one is [rad], shape [U].
        step: time since the last one [s].
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
        # Flat, as far as the limits allow: an Allegro's thumb does not reach zero.
        wanted, largest = np.clip(np.zeros(len(measured)), limits.lower, limits.upper), OPEN_SPEED * step
    # As ``np.clip``, in a third of its time.
    return setpoint + np.minimum(np.maximum(wanted - setpoint, -largest), largest)


class PolledHand(DeviceLoop):
    """What hands have in common that are read once a period; when they are under our control, they are told
    each time what follows from the goal."""

    def __init__(self, period: float, write: Callable[[str, Any], bool]):
        """period: between reads [s]; write: see ``ConfirmedWrites``."""
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
            # Somebody has connected anew after a fault.
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
        """Clear what the hand remembers of a fault."""

    @abstractmethod
    def _read_state(self) -> JointState | None:
        """The hand's state, kept as ``_state``; None where it does not answer, or can't be believed."""

    @abstractmethod
    def _move(self, goal: LoopGoal, state: JointState, elapsed: float) -> None:
        """Want what follows from the goal. elapsed: between the last two states [s]."""
