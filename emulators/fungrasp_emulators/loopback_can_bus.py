"""A CAN bus between processes of one computer, for emulated devices: frames as UDP datagrams to a multicast
group that doesn't leave the computer.

python-can's own ``udp_multicast`` reaches other computers of the network, gives every frame back to who sent
it, as no CAN adapter does, and takes some 30 microseconds for each.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time

import can

GROUP = "239.74.163.2"
"""Of the organization-local scope (RFC 2365)."""
HOST = "127.0.0.1"

_FRAME = struct.Struct("=IB3x8s")
"""As ``can_frame`` of Linux: identifier with flags, length, data."""
NO_BUFFERS = 0x1FFFFFFE
"""Identifier of a frame by which an emulator fills the queues of all others on the bus; its data are
milliseconds."""
_ERROR, _REMOTE, _EXTENDED, _STANDARD_BITS, _EXTENDED_BITS = 1 << 29, 1 << 30, 1 << 31, 0x7FF, 0x1FFFFFFF


class LoopbackCanBus(can.BusABC):
    """One who takes part in the bus with a number."""

    def __init__(self, port: int):
        """port: of UDP, the number of the bus. Raises: OSError: it is taken, or there is no multicast."""
        super().__init__(channel=str(port))
        self.channel_info = f"bus {port} of this computer"
        group = socket.inet_aton(GROUP) + socket.inet_aton(HOST)
        self._in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._in.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # To the group, so that nothing else that is sent to the port is heard.
            self._in.bind((GROUP, port))
            self._in.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
            self._in.setblocking(False)
            self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(HOST))
            self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            self._out.connect((GROUP, port))
        except OSError:
            self.shutdown()
            raise
        self._own = self._out.getsockname()
        self._full = 0.0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to all others on the bus; nobody may be there."""
        if time.monotonic() < self._full:
            raise can.CanOperationError("Transmit buffer full: No buffer space available [Error Code 105]")
        flags = _ERROR * msg.is_error_frame | _REMOTE * msg.is_remote_frame | _EXTENDED * msg.is_extended_id
        try:
            self._out.send(_FRAME.pack(msg.arbitration_id | flags, msg.dlc, bytes(msg.data)))
        except OSError as error:
            raise can.CanOperationError(str(error)) from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """See ``can.BusABC``: a frame, and that it was not filtered."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                data, sender = self._in.recvfrom(_FRAME.size)
            except BlockingIOError:
                left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
                if left == 0.0 or not select.select([self._in], [], [], left)[0]:
                    return None, False
                continue
            except (OSError, ValueError) as error:
                raise can.CanOperationError(str(error)) from error
            if sender != self._own and len(data) == _FRAME.size:
                message = _message(data)
                if message.arbitration_id != NO_BUFFERS:
                    return message, False
                self._full = time.monotonic() + 1e-3 * int.from_bytes(message.data, "little")

    def fileno(self) -> int:
        """Of the socket that receives."""
        return self._in.fileno()

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        for end in (self._in, self._out):
            with contextlib.suppress(OSError):
                end.close()


def _message(data: bytes) -> can.Message:
    word, length, content = _FRAME.unpack(data)
    extended = bool(word & _EXTENDED)
    return can.Message(
        timestamp=time.time(),
        arbitration_id=word & (_EXTENDED_BITS if extended else _STANDARD_BITS),
        is_extended_id=extended,
        is_remote_frame=bool(word & _REMOTE),
        is_error_frame=bool(word & _ERROR),
        dlc=min(length, 8),
        data=None if word & _REMOTE else content[:length],
    )
