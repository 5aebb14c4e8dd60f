"""Opens a bus of python-can."""

from __future__ import annotations

from typing import Any

from fungrasp.robots.device import RobotError
from fungrasp.robots.optional_packages import import_client, import_emulators

SERIAL_ADAPTERS = ("pcan", "kvaser", "ixxat", "slcan", "gs_usb")
"""Interfaces that set the bit rate themselves; that of "socketcan" is set with ``ip link``."""


LOOPBACK = "loopback"
"""Interface of emulated devices (``fungrasp_emulators``)."""

BUS_ERROR, BUS_OFF = 0x80, 0x40
"""Classes in the identifier of an error frame, as SocketCAN sets them (``linux/can/error.h``)."""


def open_can_bus(interface: str, channel: str, bitrate: int = 1_000_000) -> Any:
    """A ``can.Bus``.

    Args:
        interface: of python-can, or "loopback", between processes of this computer.
        channel: of the interface; that of "loopback" is a port of UDP, "43113".
        bitrate: [bit/s].

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
