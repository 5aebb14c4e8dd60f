"""Packages of Universal Robots' Real-Time Data Exchange, protocol version 2, as the controller sends and
takes them, and the connections that they come by.

A package is its length (uint16, the three bytes of the header included), a letter, and data; numbers are
big endian. A client names the variables it wants (``O``) and those it will write (``I``), each list a recipe;
data packages (``U``) carry the number of their recipe and its values. Facts from the RTDE guide of Universal
Robots.
"""

from __future__ import annotations

import contextlib
import re
import selectors
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

PROTOCOL_VERSION, CONTROLLER_VERSION, TEXT_MESSAGE = b"V", b"v", b"M"
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE, DATA = b"O", b"I", b"S", b"P", b"U"

HEADER = struct.Struct(">Hc")
_FORMATS = {"DOUBLE": "d", "UINT32": "I", "INT32": "i", "UINT64": "Q", "UINT8": "B", "BOOL": "?"}
_FORMATS |= {"VECTOR6D": "6d", "VECTOR3D": "3d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}
_NAMES = {
    "DOUBLE": "timestamp payload speed_scaling target_speed_fraction speed_slider_fraction",
    "VECTOR3D": "payload_cog",
    "VECTOR6D": "target_q target_qd actual_q actual_qd actual_current target_moment actual_TCP_pose "
    "actual_TCP_speed actual_TCP_force external_force_torque",
    "INT32": "robot_mode safety_mode",
    "UINT32": "runtime_state robot_status_bits safety_status_bits speed_slider_mask",
    "UINT8": "standard_digital_output_mask standard_digital_output",
}
_VARIABLES = {name: kind for kind, names in _NAMES.items() for name in names.split()}
_REGISTER = re.compile(r"(?:input|output)_(int|double|bit)_register_\d+")
_REGISTER_TYPES = {"int": "INT32", "double": "DOUBLE", "bit": "BOOL"}


@dataclass(frozen=True)
class Recipe:
    """Variables that go together, and their types; an unknown variable has the type "NOT_FOUND"."""

    names: tuple[str, ...]
    """Names of the variables."""
    types: tuple[str, ...]
    """Types of the variables."""

    @property
    def valid(self) -> bool:
        """Whether every variable is known."""
        return "NOT_FOUND" not in self.types

    @property
    def layout(self) -> struct.Struct:
        """Of the values; for valid recipes only."""
        return struct.Struct(">" + "".join(_FORMATS[kind] for kind in self.types))


def make_recipe(names: str) -> Recipe:
    """Recipe of a list of variables, "timestamp,actual_q"."""
    listed = tuple(name for name in names.split(",") if name)
    registers = [_REGISTER.fullmatch(name) for name in listed]
    return Recipe(
        listed,
        tuple(
            _REGISTER_TYPES[register[1]] if register else _VARIABLES.get(name, "NOT_FOUND")
            for name, register in zip(listed, registers, strict=True)
        ),
    )


def package(kind: bytes, data: bytes = b"") -> bytes:
    """A package; kind: one letter."""
    return HEADER.pack(HEADER.size + len(data), kind) + data


def split_packages(stream: bytes) -> tuple[list[tuple[bytes, bytes]], bytes]:
    """Whole packages at the start of a stream, as letters with data, and the bytes that are left."""
    packages = []
    while len(stream) >= HEADER.size:
        size, kind = HEADER.unpack_from(stream)
        if size < HEADER.size or len(stream) < size:
            break
        packages.append((kind, stream[HEADER.size : size]))
        stream = stream[size:]
    return packages, stream


def encode_values(recipe: Recipe, number: int, values: Mapping[str, Any]) -> bytes:
    """Data package of a recipe with a number. values: by name, arrays for vectors; the others are zero."""
    flat: list[Any] = []
    for name, kind in zip(recipe.names, recipe.types, strict=True):
        flat += np.broadcast_to(values.get(name, 0), int(_FORMATS[kind][:-1] or 1)).tolist()
    return package(DATA, bytes([number]) + recipe.layout.pack(*flat))


def decode_values(recipe: Recipe, data: bytes) -> dict[str, Any]:
    """Values by name of a data package's content after the number of the recipe; vectors are tuples."""
    flat: Sequence[Any] = recipe.layout.unpack(data)
    values, at = {}, 0
    for name, kind in zip(recipe.names, recipe.types, strict=True):
        count = int(_FORMATS[kind][:-1] or 1)
        values[name] = flat[at] if count == 1 else tuple(flat[at : at + count])
        at += count
    return values


@dataclass(eq=False)
class URClient:
    """Somebody who is connected to an emulated controller."""

    socket: socket.socket
    """The connection."""
    kind: int
    """Port that it came to."""
    received: bytes = b""
    """Not yet taken."""
    outputs: Recipe | None = None
    """What it wants to hear."""
    inputs: list[Recipe] = field(default_factory=list)
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
    """Servers on some ports of an address, and their clients; ``accepted`` is called with a new client."""

    def __init__(self, address: str, ports: Sequence[int], accepted: Callable[[URClient], None]):
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
            self._servers[port] = server = socket.create_server((self._address, port))
            server.setblocking(False)
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
                self._accept(self._servers[key.data], key.data)
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
        data = b""
        with contextlib.suppress(OSError):
            data = client.socket.recv(65536)
        if not data:
            self.drop(client)
            return False
        client.received += data
        return True
