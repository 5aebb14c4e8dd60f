"""What every emulator offers: start, close, faults on demand; and the joints behind it, which move."""

from __future__ import annotations

import abc
import threading
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, Protocol, Self

import numpy as np

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
    BUS_ERRORS = "bus errors"
    """The host's CAN adapter reports an error on the bus after one in ten frames."""
    BUS_OFF = "bus off"
    """The host's CAN adapter has gone off the bus: it says so once, and no frame comes or goes."""
    TOO_HOT = "too hot"
    """It says that it is; motors are on until the host takes their torque away."""
    INTERNAL = "internal fault"
    """It says that its electronics have lost touch with its motors."""
    REFUSED = "writes refused"
    """Every write is answered by a refusal."""
    UNHEARD = "writes unheard"
    """One in five writes does nothing; it is not acknowledged, where writes are."""
    MOTOR = "motor fault"
    """One of its motors has a fault and moves no more; the others do."""
    WRAPPED = "reading wrapped"
    """One of its joints is read a whole turn off."""
    NO_BUFFERS = "no buffers"
    """The host's CAN adapter takes no frame for 20 ms out of every 200 (ENOBUFS)."""
    CLOCK_JUMP = "clock jump"
    """Its clock is set to another time."""


@dataclass(frozen=True, eq=False)
class PlantCommand:
    """What a device's electronics tell its motors. With neither positions nor torques: no power."""

    positions: np.ndarray | None = None
    """Goal of position servos [rad], shape [U]."""
    torques: np.ndarray | None = None
    """Torques of torque-controlled motors [N m], shape [U]."""
    velocity_limits: np.ndarray | None = None
    """Highest speeds of position servos [rad/s], shape [U]; None: the plant's own."""
    torque_limits: np.ndarray | None = None
    """Highest torques of position servos [N m], shape [U]; None: the plant's own."""


@dataclass(frozen=True, eq=False)
class PlantState:
    """True state of the joints."""

    positions: np.ndarray
    """[rad], shape [U]."""
    velocities: np.ndarray
    """[rad/s], shape [U]."""
    torques: np.ndarray
    """Torques of the motors [N m], shape [U]."""


class Plant(Protocol):
    """Joints of an arm or a hand, in the order of its driver. May be called from several threads."""

    def apply(self, command: PlantCommand, now: float) -> None:
        """Take a command at host time ``now`` [s]; it stays until the next."""
        ...

    def state(self, now: float) -> PlantState:
        """State at host time ``now`` [s], which never decreases."""
        ...


COMMON = frozenset({Fault.STALLED, Fault.LOST, Fault.LATE, Fault.CORRUPT, Fault.WRONG_DEVICE})
"""Faults that every emulator shows."""


class Emulator(abc.ABC):
    """A device on the loopback. A context manager."""

    supported: ClassVar[frozenset[Fault]] = COMMON
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
