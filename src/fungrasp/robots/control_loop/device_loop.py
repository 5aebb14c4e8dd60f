"""What a device does at its own rate: the part of a driver that runs in a process of its own. Writes that a
limit or a stop rests on are repeated until the device shows that it has them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from fungrasp.robots.device import JointLimits, JointState, RobotError


class LoopMode(IntEnum):
    """What a device is to do."""

    IDLE = 0
    """Connected: looked at, and left as it is."""
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
    """Under our control, nothing commanded yet: no motion."""
    ABANDON = 7
    """End the loop at once: another one takes its place."""


@dataclass(frozen=True, eq=False)
class LoopGoal:
    """What the driver was last told."""

    mode: LoopMode
    """What to do."""
    positions: np.ndarray
    """Goal of ``FOLLOW`` [rad], shape [U]."""
    feedforward: np.ndarray
    """Torques to add [N m], shape [U]."""


class DeviceLoop(Protocol):
    """One device. Made, pickled and sent to the process that runs it before it is opened.

    ``step`` is called again and again and sets the pace: it waits for the device's next state or for the
    next period.
    """

    name: str
    """Type and address of the device."""
    limits: JointLimits
    """What is accepted."""
    takes_feedforward: bool = False
    """Whether feed-forward torques have an effect."""
    lets_go: str = ""
    """See ``JointDriver.lets_go``."""
    stale_after: float
    """A state older than this is no state: the device counts as disconnected [s]."""

    def open(self) -> None:
        """Connect and verify the device, which stays as it is. Raises: RobotError."""
        ...

    def take_control(self) -> None:
        """Make the device ready to follow; called before the first goal, and again after an acknowledged
        stop. Nothing moves. Raises: RobotError."""
        ...

    def step(self, goal: LoopGoal) -> JointState:
        """Read the device, send what follows from the goal, return the state.

        Where nothing is new, both the goal that is passed and the state that is returned are the same
        objects as before.

        A state whose status is not ``READY`` is latched: from then on ``step`` is called with ``HOLD``, or
        how else the driver says that motion ends, until somebody connects anew. A faulted device obeys these.

        Raises:
            RobotError: the connection is of no use any more.
        """
        ...

    def halt(self) -> bool | None:
        """End motion, on exit and on errors; a hand that holds without us keeps its hold, another one loses
        its torque. Never raises. False: the device has not shown that it obeyed, and is told again."""
        ...

    def close(self) -> None:
        """End the connection. Never raises."""
        ...

    # A loop with the two methods below keeps its device through faults; others end, and their driver starts
    # another one on connecting.

    # def recover(self) -> None: Reach a device again that ``step`` has lost; it may have been off meanwhile.
    # Raises: RobotError: it is still lost.

    # def resume(self, positions: np.ndarray) -> None: After ``open``, in the place of ``take_control``: the
    # process that led the device has died, and told it last to go to these positions [rad], shape [U].


PATIENCE = 1.0
"""A device that does not show a value within this time does not take it [s]."""
INTERVAL = 0.02
"""Between two attempts at the same value [s]."""


class ConfirmedWrites:
    """What a device must have been told. A lost write, a refused one and one that only some of its motors
    heard look alike: the value is not shown, and is written again."""

    def __init__(self, write: Callable[[str, Any], bool]):
        """write: writes a value once and says whether the device shows it, by an acknowledgment or by what is
        read back; takes the name and the value."""
        self._write = write
        self._shown: dict[str, Any] = {}
        self._open: dict[str, tuple[Any, float, float]] = {}

    def put(self, name: str, value: Any, anew: bool = False) -> None:
        """Want a value from now on; the newest counts. name: of what is written, for messages; anew: write it
        though it was shown before."""
        if anew or self.wanted(name) != value:
            since = self._open[name][1] if name in self._open else time.monotonic()
            self._open[name] = (value, since, 0.0)

    def forget(self, *names: str) -> None:
        """The device may have been switched off: what it has been told of some names is told again."""
        for name in names:
            if name in self._shown:
                self._open.setdefault(name, (self._shown.pop(name), time.monotonic(), 0.0))

    def wanted(self, name: str) -> Any:
        """The newest value of a name; None where there is none."""
        return self._open[name][0] if name in self._open else self._shown.get(name)

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of what is not shown yet."""
        return tuple(self._open)

    def work(self) -> str:
        """Write once what is not shown yet. Returns: what the device does not take, as a phrase; "" for
        nothing."""
        for name, (value, since, tried) in list(self._open.items()):
            if time.monotonic() - tried < INTERVAL:
                continue
            self._open[name] = (value, since, time.monotonic())
            if self._write(name, value):
                self._shown[name] = value
                del self._open[name]
        now = time.monotonic()
        late = [name for name, (_, since, _) in self._open.items() if now - since > PATIENCE]
        return f"it does not take what it is told: {', '.join(late)}" if late else ""

    def finish(self, device: str) -> None:
        """Write until all is shown. device: type and address, for messages. Raises: RobotError: the device
        does not take it."""
        while self._open:
            late = self.work()
            if late:
                raise RobotError(f"{device}: {late}")
            if self._open:
                time.sleep(INTERVAL / 4)
