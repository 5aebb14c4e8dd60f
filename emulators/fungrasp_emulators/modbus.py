"""The server's side of Modbus: requests for holding registers and their answers, over TCP and serial lines.

For emulators only: drivers use pymodbus, so that both sides are of different make.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

READ, WRITE_ONE, WRITE = 3, 6, 16
ILLEGAL_FUNCTION, DEVICE_FAILURE = 1, 4


@dataclass(frozen=True)
class RegisterRequest:
    """What a client wants."""

    function: int
    """``READ``, ``WRITE_ONE``, ``WRITE`` or another one, which is refused."""
    address: int
    """Of the first register."""
    count: int
    """Of registers."""
    values: tuple[int, ...] = ()
    """To write, 0 to 65535 each."""


def decode_request(data: bytes) -> RegisterRequest:
    """A request without the frame around it; data: from the function code on."""
    function, address, count = struct.unpack(">BHH", data[:5])
    if function == WRITE_ONE:
        return RegisterRequest(function, address, 1, (count,))
    values = struct.unpack(f">{count}H", data[6 : 6 + 2 * count]) if function == WRITE else ()
    return RegisterRequest(function, address, count, values)


def encode_answer(request: RegisterRequest, values: tuple[int, ...] = ()) -> bytes:
    """Answer to a request, carried out or refused. values: that were read, 0 to 65535 each."""
    if request.function not in (READ, WRITE, WRITE_ONE):
        return bytes([request.function | 0x80, ILLEGAL_FUNCTION])
    if request.function == READ:
        return struct.pack(f">BB{len(values)}H", READ, 2 * len(values), *values)
    last = request.values[0] if request.function == WRITE_ONE else request.count
    return struct.pack(">BHH", request.function, request.address, last)


def refusal(request: RegisterRequest) -> bytes:
    """Answer to a request that the device can't carry out."""
    return bytes([request.function | 0x80, DEVICE_FAILURE])


def split_tcp_requests(stream: bytes) -> tuple[list[tuple[int, int, bytes]], bytes]:
    """Whole requests at the start of a TCP stream, with their transactions and devices, and what is left."""
    requests = []
    while len(stream) >= 8:
        transaction, _, length, device = struct.unpack(">HHHB", stream[:7])
        if len(stream) < 6 + length:
            break
        requests.append((transaction, device, stream[7 : 6 + length]))
        stream = stream[6 + length :]
    return requests, stream


def tcp_frame(transaction: int, device: int, data: bytes) -> bytes:
    """Frame of an answer over TCP."""
    return struct.pack(">HHHB", transaction, 0, len(data) + 1, device) + data


def split_serial_requests(stream: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Whole requests at the start of a serial stream, each with its device, and what is left.

    Bytes that can't be the start of a request are skipped.
    """
    requests = []
    while len(stream) >= 8:
        size = 9 + stream[6] if stream[1] == WRITE else 8
        if len(stream) < size:
            break
        if checksum(stream[: size - 2]) == stream[size - 2 : size]:
            requests.append((stream[0], stream[1 : size - 2]))
            stream = stream[size:]
        else:
            stream = stream[1:]
    return requests, stream


def serial_frame(device: int, data: bytes) -> bytes:
    """Frame of an answer over a serial line."""
    return bytes([device]) + data + checksum(bytes([device]) + data)


def checksum(data: bytes) -> bytes:
    """CRC-16 of Modbus, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return struct.pack("<H", crc)
