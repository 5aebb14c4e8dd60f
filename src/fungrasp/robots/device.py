"""What every driver of an arm, a hand or an object tracker offers.

Positions are radians and meters, torques newton meters; a driver's codec translates to the units of the wire.
Host times are of ``time.monotonic`` [s]. A driver never judges a connection by the return values of a client
library: a state is as old as the device's own time stamp says.
"""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass
from enum import StrEnum
from types import ModuleType
from typing import Protocol, Self

import numpy as np

from fungrasp.core.errors import FungraspError


class RobotError(FungraspError):
    """A device can't be reached, refuses a command or has stopped. Says in one line what to do."""


class DeviceStatus(StrEnum):
    """What a device is able to do now."""

    DISCONNECTED = "disconnected"
    """No connection, or its time stamps no longer advance."""
    READY = "ready"
    """Follows commands."""
    STOPPED = "stopped"
    """Was told to stop; follows commands again after ``connect``."""
    PROTECTIVE_STOP = "protective stop"
    """The device has stopped by itself; a person must acknowledge it at the device."""
    EMERGENCY_STOP = "emergency stop"
    """The emergency stop is pressed."""
    FAULT = "fault"
    """The device reports an error; ``message`` of its state says which."""


class StopKind(StrEnum):
    """How motion ends."""

    HOLD = "hold"
    """Brake within the limits, then keep the position."""
    OPEN = "open"
    """Hands only: open slowly and stay open; an arm holds."""
    POWER_OFF = "power off"
    """Servos without torque."""


@dataclass(frozen=True, eq=False)
class JointState:
    """Joints of an arm (six) or of a hand (its U independent joints, in the order of the hand's model)."""

    positions: np.ndarray
    """Measured positions [rad], shape [U]."""
    velocities: np.ndarray
    """Measured or differentiated velocities [rad/s], shape [U]."""
    torques: np.ndarray | None
    """Measured or estimated torques [N m], shape [U]; None where the device measures none."""
    device_time: float
    """The device's own clock [s], of any origin. Where a device has none: the host time of the last complete
    frame."""
    received: float
    """Host time at which the state was received [s]."""
    status: DeviceStatus
    """What the device is able to do."""
    message: str = ""
    """What the device says of a fault, in words; of a ready one, what is worth a look."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """What a driver accepts; a command beyond is clipped, and what was sent is returned."""

    lower: np.ndarray
    """Lowest positions [rad], shape [U]."""
    upper: np.ndarray
    """Highest positions [rad], shape [U]."""
    velocity: np.ndarray
    """Highest speeds [rad/s], shape [U]."""
    torque: np.ndarray
    """Highest torques that the driver asks for [N m], shape [U]; infinite where it leaves that to the
    device."""


class JointDriver(Protocol):
    """Driver of an arm or a hand. A context manager: leaving it stops and closes."""

    name: str
    """Type and address of the device, for messages and logs."""
    limits: JointLimits
    """What the driver accepts."""
    takes_feedforward: bool
    """Whether ``command`` uses feed-forward torques; a driver of position servos ignores them."""
    lets_go: str
    """When a hand lets go of what it holds though nobody said so, as a phrase that begins with "when"; "" for
    arms, and where only a lack of power does so."""

    def connect(self) -> None:
        """Open the connection and verify type, generation and side of the device, which stays as it is:
        torque, settings, errors and a program that runs on it. Raises: RobotError: nobody answers, or another
        device than the one configured does."""
        ...

    def take_control(self) -> None:
        """Make the device ready to follow; a program that runs on it ends. Nothing moves. ``command`` does
        so, too, where nobody did, which may take seconds. Raises: RobotError: the device can't be controlled
        now."""
        ...

    def read(self) -> JointState:
        """The latest state, without waiting. Errors of the device are in its status, not raised."""
        ...

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        """Set the goal that the device moves to at its own rate, within the limits.

        Args:
            positions: goal [rad], shape [U].
            feedforward: torques that hold the device's own weight [N m], shape [U]; devices that take
                positions only ignore them.

        Returns:
            the goal that was really sent [rad], shape [U].

        Raises:
            RobotError: the device is not ready, or a value is not finite.
        """
        ...

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        """End motion. Never raises: it is called when something is wrong already."""
        ...

    def close(self) -> None:
        """Stop and end the connection; a hand keeps its hold, but for what ``lets_go`` says. May be called
        twice."""
        ...

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
        self.close()


class TrackingStatus(StrEnum):
    """What a tracker knows of the object."""

    TRACKING = "tracking"
    LOST = "lost"
    INITIALIZING = "initializing"


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """One answer of an object tracker."""

    pose_world_object: np.ndarray
    """Pose of the object in the robot's world frame, shape [7]."""
    captured: float
    """Host time at which the image was taken [s]."""
    score: float
    """Confidence, 0 to 1."""
    status: TrackingStatus
    """Whether the pose may be used."""


class PoseSource(Protocol):
    """An object tracker: a stream, a camera, a replay or a twin. A context manager."""

    name: str
    """Type and address of the source, for messages and logs."""

    def connect(self) -> None:
        """Open the source. Raises: RobotError: nobody answers."""
        ...

    def read(self) -> TrackedPose | None:
        """The newest pose, without waiting; None before the first."""
        ...

    def close(self) -> None:
        """End the connection. May be called twice."""
        ...

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class RobotState:
    """What all devices said last."""

    time: float
    """Time of the robot's clock [s]."""
    arm: JointState
    """Of the arm."""
    hand: JointState
    """Of the hand."""
    tracked: TrackedPose | None
    """Of the tracker; None before its first pose."""


@dataclass(frozen=True, eq=False)
class RobotCommand:
    """Setpoints of all servos."""

    arm: np.ndarray
    """Joints of the arm [rad], shape [A]."""
    hand: np.ndarray
    """Independent joints of the hand [rad], shape [U]; without any offset against gravity."""
    feedforward: np.ndarray
    """Torques that carry the hand's weight [N m], shape [U]."""
    palm: np.ndarray
    """Pose of the palm that the arm's joints stand for, world frame, shape [7]."""


class SafetyStop(RobotError):
    """The robot was stopped by its guard."""

    def __init__(self, reason: str, kind: StopKind = StopKind.HOLD):
        """reason: what was wrong, as a phrase."""
        super().__init__(f"the robot was stopped ({kind}): {reason}")
        self.reason, self.kind = reason, kind


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Time [s], of an origin of its own; it never goes back."""
        ...

    def sleep_until(self, when: float) -> None:
        """Return at a time [s], at once if it has passed."""
        ...


class WallClock(Clock):
    """``time.monotonic``."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, when: float) -> None:
        left = when - time.monotonic()
        if left > 0:
            time.sleep(left)


def import_client(module: str, extra: str, device: str) -> ModuleType:
    """Import a client library. extra: the extra of this package that installs it; device: what needs it, for
    the message. Raises: RobotError: it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise RobotError(
            f'{device} needs a package that is not installed ({error}): pip install ".[{extra}]" in the clone'
        ) from error


def import_emulators(module: str) -> ModuleType:
    """Import a module of the emulated devices, a package of its own beside this one (``emulators/``). module:
    of the package ``fungrasp_emulators``. Raises: RobotError: it is not installed."""
    try:
        return importlib.import_module(f"fungrasp_emulators.{module}")
    except ModuleNotFoundError as error:
        raise RobotError(
            "emulated devices are a package of their own, beside fungrasp's source: pip install ./emulators "
            f"({error})"
        ) from error
