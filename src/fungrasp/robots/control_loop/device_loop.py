"""What a device does at its own rate: the part of a driver that runs in a process of its own."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from fungrasp.robots.device import JointLimits, JointState


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
    takes_feedforward: bool
    """Whether feed-forward torques have an effect."""
    lets_go: str
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
