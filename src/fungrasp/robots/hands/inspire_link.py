"""Registers, units and connections of the Inspire RH56 hand: Modbus over TCP or a serial line, or the
manufacturer's protocol on a serial line. All have the same registers.

Six motors in the order little, ring, middle, index finger, thumb bend, thumb rotation. Angles are 0 (closed)
to 1000 (open), forces grams, speeds 0 to 1000. Register addresses count bytes, but six motors are six
consecutive registers. Sources: the manufacturer's examples (inspire_demos) and a published characterization
(correlllab, rh56_controller). The relation of angles to radians is not published, and taken as linear.

Frames of the manufacturer's protocol, 115200 bit/s, 8 data bits, no parity (The Dexterous Hands RH56 Series,
User Manual, and published clients):

    request: EB 90  id  length  command  address (2)  data      checksum
    answer:  90 EB  id  length  command  address (2)  data      checksum

The length counts the bytes from the command to the end of the data; the checksum is the low byte of the sum
from the id on. Numbers are little endian. A read (0x11) contains the number of bytes, and its answer these
bytes; a write (0x12) contains the bytes, and its answer one byte, 1 if they were accepted.
"""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.robots.device import RobotError, import_client

MOTORS = 6
HAND_ID, CLEAR_ERRORS = 1000, 1004
ANGLE_SET, FORCE_SET, SPEED_SET = 1486, 1498, 1522
ANGLE_ACTUAL, ERRORS = 1546, 1606
"""Errors are six bytes, two per register, the first in the low byte."""

SINGLE_BYTES = frozenset({HAND_ID, CLEAR_ERRORS})
"""Registers of one byte. On a serial line, a second byte would be written to the next register, which after
CLEAR_ERRORS is SAVE; over Modbus, each is a separate register."""

OPEN_ANGLE = 1000
MODEL_ORDER = np.array([3, 2, 1, 0, 5, 4])
"""Motor of each joint of the model (index, middle, ring, pinky, thumb yaw, pitch); its own inverse."""

SPEED_SETTINGS = np.array([0.0, 25, 50, 100, 250, 500, 750, 1000])
CLOSING_SPEEDS = np.array([0.0, 70, 141, 286, 706, 1449, 2049, 2342])
"""Measured speed at each setting [angle units/s], medians over 100 to 200 closings of a real hand."""

FAULTS = {1: "too hot", 3: "motor fault", 4: "communication fault"}
"""Error bits that end operation; 0 (stalled) and 2 (overcurrent) belong to grasping."""

REQUEST, ANSWER = b"\xeb\x90", b"\x90\xeb"
READ, WRITE = 0x11, 0x12
TAKEN = b"\x01"
"""Data of the answer to an accepted write."""
BEFORE_DATA = 7
"""Number of bytes in a frame before its data."""
COMMAND_SIZE = 3
"""Number of bytes of command and address, which the length counts."""


def closing_speed(setting: np.ndarray | float) -> np.ndarray:
    """Return the speed of a motor [angle units/s] at a setting, 0 to 1000."""
    return np.asarray(np.interp(setting, SPEED_SETTINGS, CLOSING_SPEEDS))


def encode_angles(positions: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[int]:
    """Return the angles of the motors, 0 to 1000.

    Args:
        positions: joints of the model [rad], shape [6].
        lower: positions of the open hand [rad], shape [6].
        upper: positions of the closed hand [rad], shape [6].
    """
    angles = OPEN_ANGLE * (upper - positions) / (upper - lower)
    return [int(a) for a in np.clip(np.rint(angles), 0, OPEN_ANGLE)[MODEL_ORDER]]


def decode_angles(registers: Sequence[int], lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the joints of the model [rad], shape [6]. registers: angles of the motors; lower, upper: see
    ``encode_angles``."""
    angles = signed(registers)[MODEL_ORDER]
    return upper - angles / OPEN_ANGLE * (upper - lower)


def signed(registers: Sequence[int]) -> np.ndarray:
    """Return registers as signed numbers, shape [N]."""
    return np.array(registers, dtype=np.uint16).astype(np.int16).astype(float)


def unpack_bytes(registers: Sequence[int]) -> list[int]:
    """Return the bytes of registers, low bytes first."""
    return [byte for register in registers for byte in (register & 0xFF, register >> 8)]


@dataclass(frozen=True)
class InspireFrame:
    """A request or an answer, without head and checksum."""

    device: int
    """Number of the hand."""
    command: int
    """``READ`` or ``WRITE``."""
    address: int
    """Address of the first byte."""
    data: bytes
    """Data; for a read request, the number of bytes."""


def encode_frame(head: bytes, frame: InspireFrame) -> bytes:
    """Encode a frame. head: ``REQUEST`` or ``ANSWER``."""
    content = struct.pack("<BBBH", frame.device, len(frame.data) + COMMAND_SIZE, frame.command, frame.address)
    content += frame.data
    return head + content + bytes([sum(content) & 0xFF])


def split_frames(head: bytes, stream: bytes) -> tuple[list[InspireFrame], bytes]:
    """Return the complete frames of a stream, and the possible start of another one. Other bytes and frames
    with a wrong checksum are skipped. head: ``REQUEST`` or ``ANSWER``."""
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
    """Pack registers, 0 to 65535 each, into bytes."""
    return struct.pack(f"<{len(registers)}H", *registers)


def registers_of(data: bytes) -> list[int]:
    """Unpack registers from bytes; a single byte is a register, too."""
    return [v for (v,) in struct.iter_unpack("<H", data + bytes(len(data) % 2))]


class ModbusLink:
    """Modbus connection by pymodbus. Over TCP, values have no checksum."""

    def __init__(self, client: Any, device: int, line: bool):
        """client: pymodbus client, not connected; line: whether it uses a serial line."""
        self._client, self._device, self._line = client, device, line
        error = import_client("pymodbus.exceptions", "inspire", "an Inspire hand").ModbusException
        self._errors: tuple[type[Exception], ...] = (error, OSError)

    def connect(self) -> bool:
        """Open the connection; return whether it succeeded."""
        with contextlib.redirect_stderr(None):
            return bool(self._client.connect())

    def read(self, address: int, count: int) -> Sequence[int] | None:
        """Read registers, 0 to 65535 each; None without a valid answer."""
        answer = self._ask("read_holding_registers", address, count=count)
        if answer is not None and len(answer.registers) != count:
            return self._resume()
        return None if answer is None else answer.registers

    def write(self, address: int, values: list[int]) -> bool:
        """Write registers; return whether the hand acknowledges them."""
        answer = self._ask("write_registers", address, values=values)
        if answer is not None and (answer.address, answer.count) != (address, len(values)):
            self._resume()
            return False
        return answer is not None

    def _ask(self, function: str, address: int, **what: Any) -> Any:
        """Return the answer of the hand; None if it refuses or does not answer."""
        try:
            answer = getattr(self._client, function)(address, device_id=self._device, **what)
        except self._errors:
            return self._resume()
        return None if answer.isError() else answer

    def close(self) -> None:
        """End the connection. Never raises."""
        with contextlib.suppress(Exception):
            self._client.close()

    def _resume(self) -> None:
        """Open a connection again that was reset. On a serial line, drop late answers: without numbers, they
        would be taken for the answer to the next request."""
        with contextlib.suppress(Exception):
            if not self._client.is_socket_open():
                self._client.connect()
            elif self._line:
                quiet = time.monotonic() + self._client.comm_params.timeout_connect
                while time.monotonic() < quiet:
                    time.sleep(0.002)
                    if self._client.socket.in_waiting:
                        self._client.socket.reset_input_buffer()


class SerialLink:
    """Connection with the manufacturer's protocol, frames EB 90, by pyserial."""

    def __init__(self, port: str, baud: int, device: int, answer_timeout: float):
        """baud: baud rate [bit/s]; answer_timeout: longest wait for an answer [s]."""
        self._serial = import_client("serial", "inspire", "an Inspire hand on a serial port")
        self._options = {"port": port, "baudrate": baud, "timeout": 0.0, "write_timeout": answer_timeout}
        self._device, self._answer_timeout = device, answer_timeout
        self._port: Any = None

    def connect(self) -> bool:
        """See ``ModbusLink.connect``."""
        try:
            # Another program on the same port would receive half of the answers.
            self._port = self._serial.Serial(**self._options, exclusive=True)
        except OSError:
            return False
        return True

    def read(self, address: int, count: int) -> Sequence[int] | None:
        """See ``ModbusLink.read``."""
        size = 1 if address in SINGLE_BYTES else 2 * count
        data = self._ask(InspireFrame(self._device, READ, address, bytes([size])))
        return registers_of(data) if data is not None and len(data) == size else None

    def write(self, address: int, values: list[int]) -> bool:
        """See ``ModbusLink.write``."""
        data = bytes(values) if address in SINGLE_BYTES else register_bytes(values)
        return self._ask(InspireFrame(self._device, WRITE, address, data)) == TAKEN

    def close(self) -> None:
        """See ``ModbusLink.close``."""
        with contextlib.suppress(Exception):
            if self._port is not None:
                self._port.close()

    def _ask(self, request: InspireFrame) -> bytes | None:
        """Return the data of the answer to a request; late answers to others are dropped."""
        try:
            self._port.reset_input_buffer()
            self._port.write(encode_frame(REQUEST, request))
            stream, deadline = b"", time.monotonic() + self._answer_timeout
            while (rest := deadline - time.monotonic()) > 0:
                self._port.timeout = rest
                stream += self._port.read(max(self._port.in_waiting, 1))
                answers, stream = split_frames(ANSWER, stream)
                for answer in answers:
                    if (answer.device, answer.command, answer.address) == (
                        self._device,
                        request.command,
                        request.address,
                    ):
                        return answer.data
        except OSError:
            self.close()
            self.connect()
        return None


InspireLink = ModbusLink | SerialLink
"""Connection to a hand."""


def open_link(address: str, port: int, baud: int, protocol: str, device: int, timeout: float) -> InspireLink:
    """Connect to a hand.

    Args:
        address: address of the hand, or a serial port.
        baud: baud rate of a serial port [bit/s].
        protocol: "tcp" or "rtu" (Modbus), or "serial".
        timeout: longest wait for an answer [s].

    Raises:
        RobotError: a package is missing, or the connection fails.
    """
    link: InspireLink
    if protocol == "serial":
        link = SerialLink(address, baud, device, timeout)
    else:
        modbus = import_client("pymodbus.client", "inspire", "an Inspire hand")
        if protocol == "rtu":
            import_client("serial", "inspire", "an Inspire hand on a serial port")
            client = modbus.ModbusSerialClient(port=address, baudrate=baud, timeout=timeout, retries=0)
        else:
            client = modbus.ModbusTcpClient(address, port=port, timeout=timeout, retries=0)
        link = ModbusLink(client, device, protocol == "rtu")
    if not link.connect():
        raise RobotError(f"nobody answers at {address}; check power, cable and address")
    return link
