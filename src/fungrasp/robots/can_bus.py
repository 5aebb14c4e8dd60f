"""Opens a bus of python-can."""

from __future__ import annotations

from typing import Any

from fungrasp.robots.device import RobotError
from fungrasp.robots.optional_packages import import_client

SERIAL_ADAPTERS = ("pcan", "kvaser", "ixxat", "slcan", "gs_usb")
"""Interfaces that set the bit rate themselves; that of "socketcan" is set with ``ip link``."""


def open_can_bus(interface: str, channel: str, bitrate: int = 1_000_000) -> Any:
    """A ``can.Bus``.

    Args:
        interface: of python-can.
        channel: of the interface. "udp_multicast" takes "239.74.163.2:43113": python-can receives what is
            sent to a port, whatever its group, so two hands need two ports.
        bitrate: [bit/s].

    Raises:
        RobotError: python-can is not installed, or there is no such bus.
    """
    can = import_client("can", "allegro", "an Allegro Hand")
    options: dict[str, Any] = {"bitrate": bitrate} if interface in SERIAL_ADAPTERS else {}
    if interface == "udp_multicast":
        channel, _, port = channel.partition(":")
        if port:
            if not port.isdecimal():
                raise RobotError(
                    f"a channel of udp_multicast is like 239.74.163.2:43113, not '{channel}:{port}'"
                )
            options["port"] = int(port)
    try:
        return can.Bus(interface=interface, channel=channel, **options)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        raise RobotError(f"cannot open the CAN bus {interface}:{channel}: {error}") from error
