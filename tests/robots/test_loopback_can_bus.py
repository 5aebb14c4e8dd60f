"""The CAN bus between processes of one computer."""

from __future__ import annotations

import os
import socket

import pytest

from fungrasp.robots.device import RobotError
from fungrasp.robots.hands.allegro_bus import LOOPBACK, open_can_bus

can = pytest.importorskip("can")
PORT = 40000 + os.getpid() % 10000


@pytest.fixture
def three():
    """Two on one bus, the third on another."""
    buses = [open_can_bus(LOOPBACK, str(port)) for port in (PORT, PORT, PORT + 1)]
    yield buses
    for bus in buses:
        bus.shutdown()


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x7FF, data=b"\x00\x01\xfe\xff1234", is_extended_id=False),
        can.Message(arbitration_id=0x80, data=b"123", is_extended_id=False),
        can.Message(arbitration_id=0x1FFFFFFF, data=b"", is_extended_id=True),
        can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8), is_extended_id=False),
        can.Message(arbitration_id=0x200, is_remote_frame=True, dlc=7, is_extended_id=False),
    ],
)
def test_the_others_on_a_bus_hear_a_frame_and_who_sent_it_does_not(three, message):
    one, two, other = three
    one.send(message)
    heard = two.recv(1.0)
    assert heard is not None and heard.equals(message, timestamp_delta=None, check_channel=False)
    assert two.recv(0.0) is None and one.recv(0.02) is None and other.recv(0.02) is None


def test_frames_keep_their_order(three):
    one, two, _ = three
    for number in range(50):
        one.send(can.Message(arbitration_id=number, is_extended_id=False))
    assert [two.recv(1.0).arbitration_id for _ in range(50)] == list(range(50))


def test_what_is_no_frame_is_not_heard(three):
    one, two, _ = three
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        stranger.sendto(b"hello", ("239.74.163.2", PORT))
    assert two.recv(0.05) is None
    one.send(can.Message(arbitration_id=5, is_extended_id=False))
    assert two.recv(1.0).arbitration_id == 5


@pytest.mark.parametrize("channel", ["", "can0", "80", "99999"])
def test_a_channel_that_is_no_port_is_refused(channel: str):
    with pytest.raises(RobotError, match="port of UDP"):
        open_can_bus(LOOPBACK, channel)
