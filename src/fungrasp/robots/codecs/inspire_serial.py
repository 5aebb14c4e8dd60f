"""Frames of the Inspire RH56's own protocol on a serial line, 115200 bit/s, 8 data bits, no parity.

    request: EB 90  id  length  command  address (2)  data      checksum
    answer:  90 EB  id  length  command  address (2)  data      checksum

The length counts the bytes from the command to the last one of the data; the checksum is the low byte of the
sum from the id on. Numbers are little endian. A read (0x11) carries the number of bytes that it wants, and
its answer those bytes; a write (0x12) carries the bytes, and its answer one byte, 1 if they were taken.
Addresses are those of ``fungrasp.robots.codecs.inspire`` and count bytes. Facts from the maker's manual (The
Dexterous Hands RH56 Series, User Manual) and from published clients.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

REQUEST, ANSWER = b"\xeb\x90", b"\x90\xeb"
READ, WRITE = 0x11, 0x12
TAKEN = b"\x01"
"""Data of the answer to a write that was carried out."""
BEFORE_DATA = 7
"""Bytes of a frame before its data."""
COMMAND_SIZE = 3
"""Of command and address, which the length counts."""


@dataclass(frozen=True)
class InspireFrame:
    """A request or an answer, without its head and checksum."""

    device: int
    """Number of the hand."""
    command: int
    """``READ`` or ``WRITE``."""
    address: int
    """Of the first byte."""
    data: bytes
    """Of a request to read: one byte, how many it wants."""


def encode_frame(head: bytes, frame: InspireFrame) -> bytes:
    """Bytes of a frame; head: ``REQUEST`` or ``ANSWER``."""
    content = struct.pack("<BBBH", frame.device, len(frame.data) + COMMAND_SIZE, frame.command, frame.address)
    content += frame.data
    return head + content + bytes([sum(content) & 0xFF])


def split_frames(head: bytes, stream: bytes) -> tuple[list[InspireFrame], bytes]:
    """Whole frames in a stream, and what may be the start of another; bytes that are none are skipped, as
    are frames whose checksum is wrong.

    Args:
        head: ``REQUEST`` or ``ANSWER``.
    """
    frames = []
    while True:
        at = stream.find(head)
        if at < 0:
            return frames, stream[-1:] if stream[-1:] == head[:1] else b""
        stream = stream[at:]
        if len(stream) <= 3:
            return frames, stream
        size = stream[3] + 5
        if size <= BEFORE_DATA:
            stream = stream[1:]
            continue
        if len(stream) < size:
            return frames, stream
        if sum(stream[2 : size - 1]) & 0xFF != stream[size - 1]:
            stream = stream[1:]
            continue
        device, _, command, address = struct.unpack_from("<BBBH", stream, 2)
        frames.append(InspireFrame(device, command, address, stream[BEFORE_DATA : size - 1]))
        stream = stream[size:]


def register_bytes(registers: Sequence[int]) -> bytes:
    """Bytes of registers, 0 to 65535 each."""
    return struct.pack(f"<{len(registers)}H", *registers)


def registers_of(data: bytes) -> list[int]:
    """Registers of bytes; a single byte is a register too."""
    return [v for (v,) in struct.iter_unpack("<H", data + bytes(len(data) % 2))]
