"""The control loop of a device, which runs in a separate process at the device's own rate. Writes on which
limits or stops depend are repeated until the device confirms them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from fungrasp.robots.device import JointLimits, JointState, RobotError


class LoopMode(IntEnum):
    """Modes of a loop."""

    IDLE = 0
    """Connected: read the device, but leave it unchanged."""
    FOLLOW = 1
    """Move to the goal within the limits."""
    HOLD = 2
    """Brake within the limits, then keep the position."""
    OPEN = 3
    """Hands: open slowly. Arms: hold."""
    POWER_OFF = 4
    """No torque."""
    CLOSE = 5
    """End the loop."""
    STAND_BY = 6
    """Under control, before the first goal: no motion."""
    ABANDON = 7
    """End the loop at once: another one replaces it."""


@dataclass(frozen=True, eq=False)
class LoopGoal:
    """Goal of a loop."""

    mode: LoopMode
    """Mode of the loop."""
    positions: np.ndarray
    """Goal of ``FOLLOW`` [rad], shape [U]."""
    feedforward: np.ndarray
    """Torques to add [N m], shape [U]."""


class DeviceLoop(Protocol):
    """Control loop of one device. It is pickled and sent to its process before it is opened.

    ``step`` is called repeatedly and sets the pace: it waits for the device's next state or the next period.
    """

    name: str
    """Type and address of the device."""
    limits: JointLimits
    """Limits of commands."""
    takes_feedforward: bool = False
    """Whether feed-forward torques have an effect."""
    lets_go: str = ""
    """See ``JointDriver.lets_go``."""
    stale_after: float
    """Age of a state beyond which the device counts as disconnected [s]."""

    def open(self) -> None:
        """Connect and verify the device, which stays unchanged. Raises: RobotError."""
        ...

    def take_control(self) -> None:
        """Make the device ready to follow: before the first goal, and again after an acknowledged stop.
        Nothing moves. Raises: RobotError."""
        ...

    def step(self, goal: LoopGoal) -> JointState:
        """Read the device, send commands for the goal, and return the state. Without news, goal and state are
        the same objects as before.

        A state that is not ``READY`` is latched: ``step`` then gets ``HOLD``, or another mode in which the
        driver stops, until the driver connects again. A faulted device must obey these modes, too.

        Raises:
            RobotError: the connection has failed.
        """
        ...

    def halt(self) -> bool | None:
        """End motion, on exit and on errors. A hand that can hold on its own keeps its grip, any other loses
        its torque. Never raises. False: the device has not confirmed, and has to be halted again."""
        ...

    def close(self) -> None:
        """End the connection. Never raises."""
        ...

    # Optional methods. Without them the loop ends, and its driver starts another one when it connects.

    # def recover(self) -> None: Reconnect to a device that ``step`` has lost; it may have been switched off.
    # Raises: RobotError: it is still lost.

    # def resume(self, positions: np.ndarray) -> None: After ``open``, instead of ``take_control``, if the
    # process that controlled the device has died. positions: its last goal [rad], shape [U].


PATIENCE = 1.0
"""Time after which an unconfirmed value counts as refused [s]."""
INTERVAL = 0.02
"""Time between two writes of the same value [s]."""


class ConfirmedWrites:
    """Repeats writes until the device confirms them. Writes may be lost, refused, or received by only some of
    the motors."""

    def __init__(self, write: Callable[[str, Any], bool]):
        """write: writes a value (name, value) once and returns whether the device confirms it, by an
        acknowledgment or by the value read back."""
        self._write = write
        self._shown: dict[str, Any] = {}
        self._open: dict[str, tuple[Any, float, float]] = {}

    def put(self, name: str, value: Any, anew: bool = False) -> None:
        """Request a value; the newest one counts. name: for messages; anew: write it even if it is confirmed
        already."""
        if anew or self.wanted(name) != value:
            since = self._open[name][1] if name in self._open else time.monotonic()
            self._open[name] = (value, since, 0.0)

    def forget(self, *names: str) -> None:
        """Write the values of some names again, as the device may have been switched off."""
        for name in names:
            if name in self._shown:
                self._open.setdefault(name, (self._shown.pop(name), time.monotonic(), 0.0))

    def wanted(self, name: str) -> Any:
        """Return the newest value of a name; None if there is none."""
        return self._open[name][0] if name in self._open else self._shown.get(name)

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of unconfirmed values."""
        return tuple(self._open)

    def work(self) -> str:
        """Write unconfirmed values once. Returns: the values that the device refuses, as a phrase, or ""."""
        for name, (value, since, tried) in list(self._open.items()):
            if time.monotonic() - tried < INTERVAL:
                continue
            self._open[name] = (value, since, time.monotonic())
            if self._write(name, value):
                self._shown[name] = value
                del self._open[name]
        now = time.monotonic()
        late = [name for name, (_, since, _) in self._open.items() if now - since > PATIENCE]
        return f"the device does not accept: {', '.join(late)}" if late else ""

    def finish(self, device: str) -> None:
        """Write until all values are confirmed. device: type and address, for messages. Raises: RobotError:
        the device refuses a value."""
        while self._open:
            late = self.work()
            if late:
                raise RobotError(f"{device}: {late}")
            if self._open:
                time.sleep(INTERVAL / 4)
