"""Ways to the registers of an Inspire RH56 hand: Modbus over TCP or a serial line, or the maker's own
protocol on a serial line. All carry the same registers (``fungrasp.robots.codecs.inspire``).
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from typing import Any, Protocol

from fungrasp.robots.codecs import inspire as codec
from fungrasp.robots.codecs import inspire_serial as frames
from fungrasp.robots.device import RobotError
from fungrasp.robots.optional_packages import import_client


class InspireLink(Protocol):
    """Reads and writes registers. Nothing is written that was not asked for."""

    def connect(self) -> bool:
        """Open the connection. Returns: whether that was possible."""
        ...

    def read(self, address: int, count: int) -> Sequence[int] | None:
        """Registers, 0 to 65535 each; None: no answer, or one that can't be."""
        ...

    def write(self, address: int, values: list[int]) -> bool:
        """Write registers. Returns: whether the hand says that it took them."""
        ...

    def close(self) -> None:
        """End the connection. Never raises."""
        ...


class ModbusLink:
    """Modbus, by pymodbus. Over TCP values have no checksum."""

    def __init__(self, client: Any, device: int, line: bool):
        """
        Args:
            client: of pymodbus, not connected.
            line: whether on a serial line.
        """
        self._client, self._device, self._line = client, device, line
        error = import_client("pymodbus.exceptions", "inspire", "an Inspire hand").ModbusException
        self._errors: tuple[type[Exception], ...] = (error, OSError)

    def connect(self) -> bool:
        """See ``InspireLink.connect``."""
        with contextlib.redirect_stderr(None):
            return bool(self._client.connect())

    def read(self, address: int, count: int) -> Sequence[int] | None:
        """See ``InspireLink.read``."""
        answer = self._ask("read_holding_registers", address, count=count)
        if answer is not None and len(answer.registers) != count:
            return self._resume()
        return None if answer is None else answer.registers

    def write(self, address: int, values: list[int]) -> bool:
        """See ``InspireLink.write``."""
        answer = self._ask("write_registers", address, values=values)
        if answer is not None and (answer.address, answer.count) != (address, len(values)):
            self._resume()
            return False
        return answer is not None

    def _ask(self, function: str, address: int, **what: Any) -> Any:
        """The hand's answer; None where it refuses or does not answer."""
        try:
            answer = getattr(self._client, function)(address, device_id=self._device, **what)
        except self._errors:
            return self._resume()
        return None if answer.isError() else answer

    def close(self) -> None:
        """See ``InspireLink.close``."""
        with contextlib.suppress(Exception):
            self._client.close()

    def _resume(self) -> None:
        """A connection that was reset is opened again; the state's age says whether that was in time. On a
        serial line an answer has no number: one that is late would be taken for that of the next request, so
        that what still comes is left out."""
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
    """The maker's own protocol, frames EB 90, by pyserial."""

    def __init__(self, port: str, baud: int, device: int, answer_timeout: float):
        """
        Args:
            baud: of the line [bit/s].
            answer_timeout: an answer that takes longer is lost [s].
        """
        self._serial = import_client("serial", "inspire", "an Inspire hand on a serial port")
        self._options = {"port": port, "baudrate": baud, "timeout": 0.0, "write_timeout": answer_timeout}
        self._device, self._answer_timeout = device, answer_timeout
        self._port: Any = None

    def connect(self) -> bool:
        """See ``InspireLink.connect``."""
        try:
            # Another program on the same port would take half of the answers.
            self._port = self._serial.Serial(**self._options, exclusive=True)
        except OSError:
            return False
        return True

    def read(self, address: int, count: int) -> Sequence[int] | None:
        """See ``InspireLink.read``."""
        size = 1 if address in codec.SINGLE_BYTES else 2 * count
        data = self._ask(frames.InspireFrame(self._device, frames.READ, address, bytes([size])))
        return frames.registers_of(data) if data is not None and len(data) == size else None

    def write(self, address: int, values: list[int]) -> bool:
        """See ``InspireLink.write``."""
        data = bytes(values) if address in codec.SINGLE_BYTES else frames.register_bytes(values)
        return self._ask(frames.InspireFrame(self._device, frames.WRITE, address, data)) == frames.TAKEN

    def close(self) -> None:
        """See ``InspireLink.close``."""
        with contextlib.suppress(Exception):
            if self._port is not None:
                self._port.close()

    def _ask(self, request: frames.InspireFrame) -> bytes | None:
        """Data of the answer to a request; answers to others, which came late, are left out."""
        try:
            self._port.reset_input_buffer()
            self._port.write(frames.encode_frame(frames.REQUEST, request))
            stream, deadline = b"", time.monotonic() + self._answer_timeout
            while (rest := deadline - time.monotonic()) > 0:
                self._port.timeout = rest
                stream += self._port.read(max(self._port.in_waiting, 1))
                answers, stream = frames.split_frames(frames.ANSWER, stream)
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


def open_link(address: str, port: int, baud: int, protocol: str, device: int, timeout: float) -> InspireLink:
    """A connected way to a hand.

    Args:
        address: of the hand, or a serial port.
        baud: of a serial port [bit/s].
        protocol: "tcp" or "rtu" (Modbus), or "serial".
        timeout: of an answer [s].

    Raises:
        RobotError: a package is missing, or nobody answers there.
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
