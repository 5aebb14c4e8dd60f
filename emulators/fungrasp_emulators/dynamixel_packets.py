"""Packets of the Dynamixel protocol 2.0.

    FF FF FD 00  id  length (2)  instruction  parameters  CRC-16 (2)

Numbers are little endian. Where parameters hold the bytes FF FF FD, one more FD is sent. Facts from the
maker's e-Manual. Drivers use dynamixel-sdk; the packets here are the other side's, of different make.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE = 0x82, 0x83
BROADCAST = 0xFE
START = b"\xff\xff\xfd\x00"


@dataclass(frozen=True)
class ServoPacket:
    """An instruction or a status."""

    device: int
    """Number of the servo; ``BROADCAST`` for all."""
    instruction: int
    """What to do."""
    parameters: bytes
    """Of the instruction; a status begins with an error byte."""


def encode_packet(packet: ServoPacket) -> bytes:
    """Bytes of a packet."""
    content = bytes([packet.instruction]) + packet.parameters.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = START + struct.pack("<BH", packet.device, len(content) + 2)
    return head + content + struct.pack("<H", packet_checksum(head + content))


def split_servo_packets(stream: bytes) -> tuple[list[ServoPacket], bytes]:
    """Whole packets in a stream, and what may be the start of another; bytes that are none are skipped."""
    packets = []
    while True:
        at = stream.find(START)
        if at < 0:
            return packets, stream[-(len(START) - 1) :]
        stream = stream[at:]
        if len(stream) < 7:
            return packets, stream
        size = 7 + struct.unpack("<H", stream[5:7])[0]
        if len(stream) < size:
            return packets, stream
        if (
            size >= 10
            and packet_checksum(stream[: size - 2]) == struct.unpack("<H", stream[size - 2 : size])[0]
        ):
            parameters = stream[8 : size - 2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            packets.append(ServoPacket(stream[4], stream[7], parameters))
            stream = stream[size:]
        else:
            stream = stream[1:]


def packet_checksum(data: bytes) -> int:
    """CRC-16 with the polynomial 0x8005, high bit first, start 0."""
    crc = 0
    for byte in data:
        crc = (crc << 8 ^ _CRC[(crc >> 8 ^ byte) & 0xFF]) & 0xFFFF
    return crc


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
        table.append(crc)
    return table


_CRC = _crc_table()
