"""What every emulator offers: start, close, faults on demand."""

from __future__ import annotations

import abc
import threading
from enum import StrEnum
from typing import ClassVar, Self

from fungrasp.robots.device import RobotError


class Fault(StrEnum):
    """What may go wrong with a device or on the way to it."""

    KILLED = "controller killed"
    """Its connections end; nobody answers new ones."""
    STALLED = "controller stalled"
    """Connections stay, nothing is answered. On a CAN bus: silence."""
    RESET = "connection reset"
    """Connections are reset once; new ones are answered."""
    LOST = "frames lost"
    """One in ten answers is not sent."""
    DOUBLED = "frames doubled"
    """Every answer is sent twice."""
    LATE = "frames late"
    """One in ten answers waits for the next one."""
    CORRUPT = "frames corrupt"
    """One in ten answers holds random bytes."""
    PROTECTIVE_STOP = "protective stop"
    """The device stops by itself and waits for a person."""
    EMERGENCY_STOP = "emergency stop"
    """Its emergency stop is pressed."""
    SAFEGUARD_STOP = "safeguard stop"
    """A guard, such as the door of a cell, is open: it pauses until that is closed."""
    POWER_LOSS = "power loss"
    """Motors without power; the electronics may answer or not, as on the real device."""
    WRONG_DEVICE = "wrong device"
    """It says that it is of another side, generation or type."""
    SATURATED = "registers saturated"
    """Its position registers hold their largest value."""
    FROZEN = "frozen"
    """The same answer again and again, with old time stamps."""
    JUMPING = "jumping"
    """Values jump."""
    GONE = "gone"
    """It says that it sees nothing."""
    BUS_ERRORS = "bus errors"
    """The host's CAN adapter reports an error on the bus after one in ten frames."""
    BUS_OFF = "bus off"
    """The host's CAN adapter has gone off the bus: it says so once, and no frame comes or goes."""
    TOO_HOT = "too hot"
    """It says that it is; motors are on until the host takes their torque away."""
    INTERNAL = "internal fault"
    """It says that its electronics have lost touch with its motors."""
    CLOCK_JUMP = "clock jump"
    """Its clock is set to another time."""


class Emulator(abc.ABC):
    """A device on the loopback. A context manager."""

    supported: ClassVar[frozenset[Fault]] = frozenset()
    """Faults that it can show."""

    def __init__(self) -> None:
        self._active: frozenset[Fault] = frozenset()
        self._ended = threading.Event()
        self._threads: list[threading.Thread] = []

    @abc.abstractmethod
    def start(self) -> None:
        """Answer on the wire from now on."""

    @abc.abstractmethod
    def close(self) -> None:
        """Stop answering. May be called twice."""

    def inject(self, fault: Fault) -> None:
        """Show a fault until ``clear``.

        Raises:
            RobotError: this device has no such fault.
        """
        if fault not in self.supported:
            raise RobotError(f"{type(self).__name__} has no fault '{fault}'")
        self._active |= {fault}

    def clear(self) -> None:
        """End every fault."""
        self._active = frozenset()

    def shows(self, fault: Fault) -> bool:
        """Whether a fault is being shown."""
        return fault in self._active

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _run(self, target, *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _end_threads(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(2.0)
        self._threads.clear()
