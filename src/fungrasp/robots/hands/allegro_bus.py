"""CAN bus and frames of an Allegro Hand, generations 4 and 5.

Both generations have the same identifiers, ``code << 2 | device``, and four little-endian int16 for the
joints of a finger. Their units differ, and frames do not tell the generation. Source: published drivers of
Wonik Robotics (allegro_hand_ros_v4, allegro_hand_ros2_v5).

| code | from | data |
| --- | --- | --- |
| 0x40, 0x41 | host | servos on, off |
| 0x60 to 0x63 | host | torque of a finger: V4 pulse width, V5 current |
| 0x81 | host | periods of position, IMU, temperature [ms], uint16 each |
| 0x20 to 0x23 | hand | positions of a finger |
| 0x80 | hand, on request | hardware and firmware version, side, temperature, status |
| 0x88 | hand, on request | serial number; V5: third character type, fourth side |
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.robots.device import RobotError, import_client, import_emulators

SERVOS_ON, SERVOS_OFF = 0x40, 0x41
TORQUE, POSITION, PERIODS = 0x60, 0x20, 0x81
INFO, SERIAL = 0x80, 0x88
FINGERS_ON_BUS = 4
"""Index, middle, ring, thumb, with four joints each, from base to tip."""

FINGER_BYTES = 8
"""Four int16."""
_PERIODS = struct.Struct("<3H")
_INFO = struct.Struct("<HHBBB")


@dataclass(frozen=True, eq=False)
class AllegroGeneration:
    """Units of a generation of the hand."""

    number: int
    """Number of the generation, 4 or 5, as in the high byte of the hardware version."""
    radians_per_count: float
    """Unit of positions [rad]."""
    counts_per_torque: np.ndarray
    """Torque counts per torque [1/(N m)], shape [16]."""
    largest_count: np.ndarray
    """Largest torque counts, shape [16]."""

    @property
    def torque_limits(self) -> np.ndarray:
        """Largest torques that can be sent [N m], shape [16]."""
        return self.largest_count / self.counts_per_torque


ALLEGRO_V4 = AllegroGeneration(
    number=4,
    radians_per_count=np.deg2rad(333.3 / 65536),
    counts_per_torque=np.full(16, 1200.0),
    # Pulse widths of the published driver at 12 V.
    largest_count=np.array([375.0, 675.0, 450.0, 285.0] * 3 + [525.0, 405.0, 270.0, 270.0]),
)
ALLEGRO_V5 = AllegroGeneration(
    number=5,
    radians_per_count=np.deg2rad(0.088),
    # 1.43 A per N m, sent in milliamperes; clipped as in the published driver.
    counts_per_torque=np.full(16, 1430.0),
    largest_count=np.full(16, 240.0),
)
ALLEGRO_V5_GEARED = AllegroGeneration(
    number=5,
    radians_per_count=ALLEGRO_V5.radians_per_count,
    # Hands of another type than A have twice the gear ratio at the fingers' second joints.
    counts_per_torque=np.where(np.isin(np.arange(16), (1, 5, 9)), 715.0, 1430.0),
    largest_count=np.full(16, 240.0),
)


@dataclass(frozen=True)
class AllegroInfo:
    """Version and status of a hand."""

    hardware: int
    """Hardware version; its high byte is the generation."""
    firmware: int
    """Firmware version."""
    left: bool
    """Whether a V4 is a left hand; the serial number tells the side of a V5."""
    temperature: int
    """Temperature [°C]."""
    servos_on: bool
    """Whether the servos have power."""
    overheated: bool
    """Whether the hand reports a high temperature."""
    communication_fault: bool
    """Whether the hand reports an internal communication fault."""


def identifier(code: int, device: int = 0) -> int:
    """Return the CAN identifier of a code. device: number set in the hand, 0 to 3."""
    return code << 2 | device


def code_of(can_identifier: int) -> int:
    """Return the code of a CAN identifier."""
    return can_identifier >> 2


def decode_positions(generation: AllegroGeneration, frames: Sequence[bytes]) -> np.ndarray:
    """Decode positions of all fingers [rad], shape [16]. frames: one of each finger, in order."""
    return np.frombuffer(b"".join(frames), dtype="<i2") * generation.radians_per_count


def encode_torques(generation: AllegroGeneration, torques: np.ndarray) -> list[bytes]:
    """Encode torques of all fingers [N m], shape [16], clipped to ``torque_limits``; one frame per finger."""
    largest = generation.largest_count
    # Like ``np.clip``, in a third of its time.
    within = np.minimum(np.maximum(torques * generation.counts_per_torque, -largest), largest)
    data = np.rint(within).astype("<i2").tobytes()
    return [data[at : at + FINGER_BYTES] for at in range(0, len(data), FINGER_BYTES)]


def encode_periods(position: int) -> bytes:
    """Encode the period at which the hand sends positions [ms]; it sends neither motion nor temperature."""
    return _PERIODS.pack(position, 0, 0)


def decode_info(data: bytes) -> AllegroInfo:
    """Decode version and status of a hand."""
    hardware, firmware, side, temperature, status = _INFO.unpack(data[: _INFO.size])
    flags = (bool(status & bit) for bit in (1, 2, 4))
    return AllegroInfo(hardware, firmware, side != 0, temperature, *flags)


SERIAL_ADAPTERS = ("pcan", "kvaser", "ixxat", "slcan", "gs_usb")
"""Interfaces that set the bit rate themselves; for "socketcan", ``ip link`` sets it."""

LOOPBACK = "loopback"
"""Interface of emulated devices (``fungrasp_emulators``)."""


def open_can_bus(interface: str, channel: str, bitrate: int = 1_000_000) -> Any:
    """Open a ``can.Bus``.

    Args:
        interface: interface of python-can, or "loopback" between processes of this computer.
        channel: channel of the interface; for "loopback" a UDP port, such as "43113".
        bitrate: bit rate [bit/s].

    Raises:
        RobotError: python-can is not installed, or there is no such bus.
    """
    can = import_client("can", "allegro", "an Allegro Hand")
    options: dict[str, Any] = {"bitrate": bitrate} if interface in SERIAL_ADAPTERS else {}
    try:
        if interface == LOOPBACK:
            return _loopback(channel)
        return can.Bus(interface=interface, channel=channel, **options)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        raise RobotError(f"cannot open the CAN bus {interface}:{channel}: {error}") from error


def _loopback(channel: str) -> Any:
    if not channel.isdecimal() or not 1024 <= int(channel) <= 65535:
        raise RobotError(f"a channel of {LOOPBACK} is a port of UDP from 1024 to 65535, not '{channel}'")
    return import_emulators("loopback_can_bus").LoopbackCanBus(int(channel))


BUS_ERROR, BUS_OFF = 0x80, 0x40
"""Error classes in the identifier of an error frame (SocketCAN, ``linux/can/error.h``)."""
