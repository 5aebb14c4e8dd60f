"""Connections of an emulated UR controller: one thread listens, receives and sends."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from fungrasp.robots.codecs import rtde as codec


@dataclass(eq=False)
class URClient:
    """Somebody who is connected."""

    socket: socket.socket
    """The connection."""
    kind: int
    """Port that it came to."""
    received: bytes = b""
    """Not yet taken."""
    outputs: codec.Recipe | None = None
    """What it wants to hear."""
    inputs: list[codec.Recipe] = field(default_factory=list)
    """What it will write, by number less one."""
    interval: float = 0.002
    """Between two packages that it wants [s]."""
    due: float = 0.0
    """Host time of the next one [s]."""
    started: bool = False
    """Whether it wants any now."""
    held: bytes = b""
    """A package that comes late."""


class URConnections:
    """Servers on some ports of an address, and their clients."""

    def __init__(self, address: str, ports: Sequence[int], accepted: Callable[[URClient], None]):
        """
        Args:
            address: to listen on.
            ports: to listen on.
            accepted: called with a new client.
        """
        self._address, self._ports, self._accepted = address, ports, accepted
        self._selector = selectors.DefaultSelector()
        self._servers: dict[int, socket.socket] = {}
        self.clients: list[URClient] = []
        """Those connected."""

    @property
    def listening(self) -> bool:
        """Whether somebody can connect."""
        return bool(self._servers)

    def listen(self) -> None:
        """Accept connections from now on. Raises: OSError."""
        for port in self._ports:
            server = socket.socket()
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind((self._address, port))
            server.listen()
            server.setblocking(False)
            self._servers[port] = server
            self._selector.register(server, selectors.EVENT_READ, port)

    def hang_up(self) -> None:
        """End all connections; nobody can connect."""
        for client in list(self.clients):
            self.drop(client)
        for server in self._servers.values():
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(server)
            server.close()
        self._servers.clear()

    def drop(self, client: URClient, reset: bool = False) -> None:
        """End a connection; reset: as when it breaks."""
        if reset:
            client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.socket.close()
        self.clients.remove(client)

    def receive(self, timeout: float) -> list[URClient]:
        """Wait for data, or for somebody to connect, at most so long [s]; those who have sent something."""
        found = []
        for key, _ in self._selector.select(timeout):
            if isinstance(key.data, int):
                self._accept(key.fileobj, key.data)  # pyright: ignore[reportArgumentType]
            elif self._read(key.data):
                found.append(key.data)
        return found

    def send(self, client: URClient, data: bytes) -> None:
        """Send; who can't be reached is dropped."""
        try:
            client.socket.sendall(data)
        except OSError:
            if client in self.clients:
                self.drop(client)

    def _accept(self, server: socket.socket, port: int) -> None:
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(0.2)
        client = URClient(connection, port)
        self.clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        self._accepted(client)

    def _read(self, client: URClient) -> bool:
        try:
            data = client.socket.recv(65536)
        except OSError:
            data = b""
        if not data:
            self.drop(client)
            return False
        client.received += data
        return True
