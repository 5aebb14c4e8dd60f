"""Interfaces of drivers for arms, hands and object trackers.

Positions are in radians and meters, torques in newton meters; drivers convert the units of their devices.
Host times are those of ``time.monotonic`` [s]. Drivers judge a connection by the time stamps of the device,
never by the return values of a client library.
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
    """A device can't be reached, refuses a command or has stopped. The message says what to do."""


class DeviceStatus(StrEnum):
    """State of a device."""

    DISCONNECTED = "disconnected"
    """No connection, or its time stamps no longer advance."""
    READY = "ready"
    """Follows commands."""
    STOPPED = "stopped"
    """The driver has stopped it; it follows commands again after ``connect``."""
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
    """Switch the servos' torque off."""


@dataclass(frozen=True, eq=False)
class JointState:
    """Joints of an arm or a hand: U independent joints in the order of its model."""

    positions: np.ndarray
    """Measured positions [rad], shape [U]."""
    velocities: np.ndarray
    """Measured or differentiated velocities [rad/s], shape [U]."""
    torques: np.ndarray | None
    """Measured or estimated torques [N m], shape [U]; None if the device measures none."""
    device_time: float
    """Time stamp by the device's clock, of any origin [s]; for a device without a clock, the host time of the
    last complete frame."""
    received: float
    """Host time at which the state was received [s]."""
    status: DeviceStatus
    """State of the device."""
    message: str = ""
    """Description of a fault; for a ready device, remarks."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits to which a driver clips commands."""

    lower: np.ndarray
    """Lowest positions [rad], shape [U]."""
    upper: np.ndarray
    """Highest positions [rad], shape [U]."""
    velocity: np.ndarray
    """Highest speeds [rad/s], shape [U]."""
    torque: np.ndarray
    """Highest torques that the driver requests [N m], shape [U]; infinite if only the device limits them."""


class JointDriver(Protocol):
    """Driver of an arm or a hand. A context manager: leaving it stops and closes."""

    name: str
    """Type and address of the device, for messages and logs."""
    limits: JointLimits
    """Limits to which commands are clipped."""
    takes_feedforward: bool
    """Whether ``command`` uses feed-forward torques; a driver of position servos ignores them."""
    lets_go: str
    """When the hand lets go of an object on its own, as a phrase that begins with "when"; "" for arms, and
    for hands that do so only without power."""

    def connect(self) -> None:
        """Open the connection and verify type, generation and side of the device. Its torque, settings,
        errors and running program stay unchanged. Raises: RobotError: no answer, or not the configured
        device."""
        ...

    def take_control(self) -> None:
        """Make the device ready to follow; a program that runs on it ends. Nothing moves. ``command`` calls
        this if needed; it may take seconds. Raises: RobotError: the device can't be controlled now."""
        ...

    def read(self) -> JointState:
        """Return the latest state without waiting. Errors of the device are in its status, not raised."""
        ...

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        """Set the goal, to which the device moves at its own rate within the limits.

        Args:
            positions: goal [rad], shape [U].
            feedforward: torques that compensate the device's own weight [N m], shape [U]; zero if None.

        Returns:
            the goal as sent, within the limits [rad], shape [U].

        Raises:
            RobotError: the device is not ready, or a value is not finite.
        """
        ...

    def stop(self, kind: StopKind = StopKind.HOLD) -> None:
        """End motion. Never raises."""
        ...

    def close(self) -> None:
        """Stop and end the connection; a hand keeps its grip, except as ``lets_go`` says. May be called
        twice."""
        ...

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()
        self.close()


class TrackingStatus(StrEnum):
    """State of a tracker."""

    TRACKING = "tracking"
    LOST = "lost"
    INITIALIZING = "initializing"


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """One pose from an object tracker."""

    pose_world_object: np.ndarray
    """Pose of the object in the robot's world frame, shape [7]."""
    captured: float
    """Host time at which the image was taken [s]."""
    score: float
    """Confidence, 0 to 1."""
    status: TrackingStatus
    """State of the tracker; robots only use poses with TRACKING."""


class PoseSource(Protocol):
    """An object tracker: a stream, a camera or a twin. A context manager."""

    name: str
    """Type and address of the source, for messages and logs."""

    def connect(self) -> None:
        """Open the source. Raises: RobotError: no answer."""
        ...

    def read(self) -> TrackedPose | None:
        """Return the newest pose without waiting; None before the first."""
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
    """Latest states of all devices."""

    time: float
    """Time on the robot's clock [s]."""
    arm: JointState
    """State of the arm."""
    hand: JointState
    """State of the hand."""
    tracked: TrackedPose | None
    """Last pose with status TRACKING; None before the first."""


@dataclass(frozen=True, eq=False)
class RobotCommand:
    """Setpoints of all servos."""

    arm: np.ndarray
    """Joints of the arm [rad], shape [A]."""
    hand: np.ndarray
    """Independent joints of the hand, without gravity compensation [rad], shape [U]."""
    feedforward: np.ndarray
    """Torques for gravity compensation [N m], shape [U]."""
    palm: np.ndarray
    """Palm pose at these arm joints, world frame, shape [7]."""


class SafetyStop(RobotError):
    """The robot was stopped by the safety filter, the stop switch or a person."""

    def __init__(self, reason: str, kind: StopKind = StopKind.HOLD):
        """reason: a phrase."""
        super().__init__(f"the robot was stopped ({kind}): {reason}")
        self.reason, self.kind = reason, kind


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Return the time, which never goes back, since some origin [s]."""
        ...

    def sleep_until(self, when: float) -> None:
        """Wait until a time [s]; return at once if it has passed."""
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
    """Import a client library. extra: optional dependency that installs it; device: description of its user,
    for the message. Raises: RobotError: it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise RobotError(
            f'{device} needs a package that is not installed ({error}): pip install ".[{extra}]" in the clone'
        ) from error


def import_emulators(module: str) -> ModuleType:
    """Import a module of ``fungrasp_emulators``, a separate package in ``emulators/``. Raises: RobotError: it
    is not installed."""
    try:
        return importlib.import_module(f"fungrasp_emulators.{module}")
    except ModuleNotFoundError as error:
        raise RobotError(
            "emulated devices are a package of their own, beside fungrasp's source: pip install ./emulators "
            f"({error})"
        ) from error
