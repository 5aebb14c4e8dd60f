"""The controller of a UR arm: RTDE, dashboard and script server on one address of the loopback.

Enough of it for the client library ur_rtde: its program is "uploaded" (taken, not interpreted), and the
commands that this program would read from the input registers are carried out. Ports are fixed, so several
controllers take several addresses, 127.0.0.2, 127.0.0.3, ...; on 127.0.0.1 the client skips its check of
remote control.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from fungrasp.robots.codecs import rtde as codec
from fungrasp.robots.device import RobotError
from fungrasp.robots.emulators.emulator import Emulator, Fault
from fungrasp.robots.emulators.plant import Plant, PlantCommand

RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORT = 30004, 29999, 30003
COMMAND = "input_int_register_0"
STATE = "output_int_register_0"
READY, DONE = 1, 2
"""What the client's program answers in ``STATE``."""
SERVO_JOINTS, SERVO_STOP, SET_WATCHDOG, KICK_WATCHDOG, STOP_PROGRAM = 11, 16, 35, 99, 255
"""Commands of the client's program that are carried out; any other is answered and does nothing."""
STOPPED, PLAYING = 1, 2
CLOCK_JUMP = 3600.0
"""By so much the clock is set forward, and back when the fault ends [s]."""
RELEASE_TIME = 5.0
"""A real controller unlocks a protective stop 5 s after it happened at the earliest [s]."""


class SafetyBit(IntEnum):
    """Bits of the controller's safety status."""

    NORMAL = 0
    PROTECTIVE_STOP = 2
    ROBOT_EMERGENCY_STOP = 6
    EMERGENCY_STOP = 7
    STOPPED = 10


@dataclass(eq=False)
class _Client:
    socket: socket.socket
    kind: int
    received: bytes = b""
    outputs: codec.Recipe | None = None
    inputs: list[codec.Recipe] = field(default_factory=list)
    interval: float = 0.002
    due: float = 0.0
    started: bool = False
    held: bytes = b""


class URControllerEmulator(Emulator):
    """A controller with a program of ur_rtde; ``servoj`` goes to the plant as it comes."""

    supported = frozenset(
        {
            Fault.KILLED,
            Fault.STALLED,
            Fault.RESET,
            Fault.LOST,
            Fault.DOUBLED,
            Fault.LATE,
            Fault.CORRUPT,
            Fault.PROTECTIVE_STOP,
            Fault.EMERGENCY_STOP,
            Fault.WRONG_DEVICE,
            Fault.FROZEN,
            Fault.CLOCK_JUMP,
        }
    )

    def __init__(
        self,
        plant: Plant,
        address: str = "127.0.0.2",
        version: tuple[int, int, int] = (5, 11, 0),
        model: str = "UR5",
        serial: str = "20205500001",
        seed: int = 0,
        release_time: float = RELEASE_TIME,
    ):
        """
        Args:
            plant: six joints.
            address: of the loopback.
            version: of the controller's software; 3 is a CB3 controller (125 Hz), 5 an e-Series (500 Hz).
            model: "UR3", "UR5", "UR10", ...
            serial: number of the robot.
            seed: of the packages that faults take.
            release_time: a protective stop can't be unlocked before [s].
        """
        super().__init__()
        self.plant = plant
        self.address = address
        self._version, self._model, self._serial = version, model, serial
        self._period = 0.008 if version[0] < 5 else 0.002
        self._release_time = release_time
        self._rng = np.random.default_rng(seed)
        self._selector = selectors.DefaultSelector()
        self._servers: dict[int, socket.socket] = {}
        self._clients: list[_Client] = []
        self._program = STOPPED
        self._answer, self._executing = 0, False
        self._inputs: dict[str, Any] = {}
        self._heard, self._watchdog = 0.0, 0.0
        self._stop_began = 0.0
        self._origin = time.monotonic()
        self._frozen_time: float | None = None
        self._goal: np.ndarray | None = None

    @property
    def program_running(self) -> bool:
        """Whether the client's program runs."""
        return self._program == PLAYING

    def start(self) -> None:
        """See ``Emulator.start``."""
        self._ended.clear()
        try:
            self._listen()
        except OSError as error:
            self._hang_up()
            raise RobotError(f"the UR emulator cannot listen on {self.address}: {error.strerror}") from error
        self._run(self._serve)

    def close(self) -> None:
        """See ``Emulator.close``."""
        self._end_threads()
        self._hang_up()

    def inject(self, fault: Fault) -> None:
        """See ``Emulator.inject``. A stop ends the program and stays when the fault is cleared."""
        super().inject(fault)
        if fault is Fault.FROZEN:
            self._frozen_time = time.monotonic() - self._origin
        if fault in (Fault.PROTECTIVE_STOP, Fault.EMERGENCY_STOP):
            self._stop_began = time.monotonic()

    def clear(self) -> None:
        """End every fault but a protective stop, which ``unlock_protective_stop`` ends."""
        self._active = self._active & {Fault.PROTECTIVE_STOP}

    def unlock_protective_stop(self) -> None:
        """What a person does at the pendant."""
        self._active = self._active - {Fault.PROTECTIVE_STOP}

    def _listen(self) -> None:
        for port in (RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORT):
            server = socket.socket()
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind((self.address, port))
            server.listen()
            server.setblocking(False)
            self._servers[port] = server
            self._selector.register(server, selectors.EVENT_READ, port)

    def _hang_up(self, reset: bool = False) -> None:
        for client in list(self._clients):
            self._drop(client, reset)
        for server in self._servers.values():
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(server)
            server.close()
        self._servers.clear()

    def _drop(self, client: _Client, reset: bool = False) -> None:
        if reset:
            client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        client.socket.close()
        self._clients.remove(client)

    def _serve(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            if self.shows(Fault.STALLED):
                time.sleep(0.001)
                continue
            self._obey_faults()
            for key, _ in self._selector.select(max(0.0, due - time.monotonic())):
                if isinstance(key.data, int):
                    self._accept(key.fileobj, key.data)
                else:
                    self._read(key.data)
            now = time.monotonic()
            if now >= due:
                due = max(due + self._period, now)
                self._tick(now)

    def _obey_faults(self) -> None:
        if self.shows(Fault.KILLED) and self._servers:
            self._hang_up()
            self._stop_program()
        elif not self.shows(Fault.KILLED) and not self._servers:
            self._listen()
        if self.shows(Fault.RESET):
            for client in list(self._clients):
                self._drop(client, reset=True)
            self._stop_program()
            self._active = self._active - {Fault.RESET}
        if self.shows(Fault.PROTECTIVE_STOP) or self.shows(Fault.EMERGENCY_STOP):
            self._stop_program()

    def _accept(self, server: Any, port: int) -> None:
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(0.2)
        client = _Client(connection, port)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        if port == DASHBOARD_PORT:
            self._send(client, b"Connected: Universal Robots Dashboard Server\n")

    def _read(self, client: _Client) -> None:
        try:
            data = client.socket.recv(65536)
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        client.received += data
        if client.kind == RTDE_PORT:
            packages, client.received = codec.split_packages(client.received)
            for kind, content in packages:
                try:
                    self._take_package(client, kind, content)
                except (IndexError, KeyError, struct.error):
                    # As a real controller does with what it can't read.
                    self._drop(client)
                    return
        elif client.kind == DASHBOARD_PORT:
            *lines, client.received = client.received.split(b"\n")
            for line in lines:
                self._send(client, self._dashboard(line.decode().strip()).encode() + b"\n")
        elif client.received.endswith(b"\nend\n"):
            client.received = b""
            self._start_program()

    def _send(self, client: _Client, data: bytes) -> None:
        try:
            client.socket.sendall(data)
        except OSError:
            if client in self._clients:
                self._drop(client)

    def _take_package(self, client: _Client, kind: bytes, content: bytes) -> None:
        if kind == codec.DATA:
            recipe = client.inputs[content[0] - 1]
            values = codec.decode_values(recipe, content[1:])
            self._inputs |= values
            if COMMAND in values:
                self._heard = time.monotonic()
                self._command(int(values[COMMAND]))
        elif kind == codec.PROTOCOL_VERSION:
            self._send(client, codec.package(kind, b"\x01"))
        elif kind == codec.CONTROLLER_VERSION:
            self._send(client, codec.package(kind, struct.pack(">4I", *self._version, 1)))
        elif kind == codec.SETUP_OUTPUTS:
            client.outputs = codec.make_recipe(content[8:].decode())
            client.interval = 1.0 / max(struct.unpack(">d", content[:8])[0], 1.0)
            self._send(client, codec.package(kind, b"\x01" + ",".join(client.outputs.types).encode()))
        elif kind == codec.SETUP_INPUTS:
            recipe = codec.make_recipe(content.decode())
            client.inputs.append(recipe)
            number = bytes([len(client.inputs)])
            self._send(client, codec.package(kind, number + ",".join(recipe.types).encode()))
        elif kind in (codec.START, codec.PAUSE):
            client.started = kind == codec.START
            self._send(client, codec.package(kind, b"\x01"))

    def _start_program(self) -> None:
        if self.shows(Fault.PROTECTIVE_STOP) or self.shows(Fault.EMERGENCY_STOP):
            return
        self._program, self._answer, self._executing = PLAYING, READY, False
        self._watchdog = 0.0

    def _stop_program(self) -> None:
        if self._program == PLAYING:
            self._program, self._watchdog = STOPPED, 0.0
            self._stop_servo()

    def _stop_servo(self) -> None:
        if self._goal is not None:
            now = time.monotonic()
            self.plant.apply(PlantCommand(positions=self.plant.state(now).positions), now)
            self._goal = None

    def _command(self, command: int) -> None:
        if self._program != PLAYING:
            return
        if command == SERVO_JOINTS:
            self._goal = np.array([self._inputs[f"input_double_register_{i}"] for i in range(6)])
            self.plant.apply(PlantCommand(positions=self._goal), time.monotonic())
            self._answer = READY
        elif command == STOP_PROGRAM:
            self._stop_program()
        elif command in (0, KICK_WATCHDOG):
            self._answer, self._executing = READY, False
        elif not self._executing:
            if command == SERVO_STOP:
                self._stop_servo()
            elif command == SET_WATCHDOG:
                self._watchdog = float(self._inputs["input_double_register_0"])
            self._answer, self._executing = DONE, True

    def _tick(self, now: float) -> None:
        if self._watchdog > 0 and now - self._heard > 1.0 / self._watchdog:
            self._stop_program()
        if not any(client.started for client in self._clients):
            return
        state = self.plant.state(now)
        stopped = self.shows(Fault.PROTECTIVE_STOP) or self.shows(Fault.EMERGENCY_STOP)
        clock = now - self._origin + CLOCK_JUMP * self.shows(Fault.CLOCK_JUMP)
        if self.shows(Fault.FROZEN):
            clock = self._frozen_time
        values = {
            "timestamp": clock,
            "actual_q": state.positions,
            "actual_qd": state.velocities,
            "target_q": state.positions if self._goal is None else self._goal,
            "target_moment": state.torques,
            "runtime_state": self._program,
            "robot_mode": 7,
            "safety_mode": 3 if self.shows(Fault.PROTECTIVE_STOP) else 7 if stopped else 1,
            "robot_status_bits": 1 | (self._program == PLAYING) << 1,
            "safety_status_bits": self._safety_bits(),
            STATE: self._answer,
        }
        for client in list(self._clients):
            if client.started and client.outputs is not None and client.outputs.valid and now >= client.due:
                client.due = max(client.due + client.interval, now)
                self._send(client, self._disturbed(client, codec.encode_values(client.outputs, 1, values)))

    def _safety_bits(self) -> int:
        bits = {SafetyBit.NORMAL}
        if self.shows(Fault.PROTECTIVE_STOP):
            bits = {SafetyBit.PROTECTIVE_STOP, SafetyBit.STOPPED}
        if self.shows(Fault.EMERGENCY_STOP):
            bits = {SafetyBit.ROBOT_EMERGENCY_STOP, SafetyBit.EMERGENCY_STOP, SafetyBit.STOPPED}
        return sum(1 << bit for bit in bits)

    def _disturbed(self, client: _Client, data: bytes) -> bytes:
        chosen = self._rng.random() < 0.1
        if chosen and self.shows(Fault.LOST):
            return b""
        if chosen and self.shows(Fault.CORRUPT):
            head = codec.HEADER.size + 1
            return data[:head] + self._rng.bytes(len(data) - head)
        if self.shows(Fault.DOUBLED):
            return data + data
        if self.shows(Fault.LATE):
            late, client.held = client.held, data if chosen else b""
            return late if chosen else late + data
        return data

    def _dashboard(self, line: str) -> str:
        answers: dict[str, Callable[[], str]] = {
            "PolyscopeVersion": lambda: "URSoftware {}.{}.{}.1 (Jan 01 2026)".format(*self._version),
            "get robot model": lambda: "UR3" if self.shows(Fault.WRONG_DEVICE) else self._model,
            "get serial number": lambda: self._serial,
            "is in remote control": lambda: "true",
            "robotmode": lambda: "Robotmode: RUNNING",
            "programState": lambda: (
                "PLAYING rtde_control" if self.program_running else "STOPPED rtde_control"
            ),
            "running": lambda: f"Program running: {str(self.program_running).lower()}",
            "safetystatus": lambda: f"Safetystatus: {self._safety_status()}",
            "safetymode": lambda: f"Safetymode: {self._safety_status()}",
            "stop": self._stopped_by_dashboard,
            "unlock protective stop": self._unlocked_by_dashboard,
        }
        answer = answers.get(line)
        return answer() if answer else f"could not understand: '{line}'"

    def _safety_status(self) -> str:
        if self.shows(Fault.EMERGENCY_STOP):
            return "ROBOT_EMERGENCY_STOP"
        return "PROTECTIVE_STOP" if self.shows(Fault.PROTECTIVE_STOP) else "NORMAL"

    def _stopped_by_dashboard(self) -> str:
        self._stop_program()
        return "Stopped"

    def _unlocked_by_dashboard(self) -> str:
        if time.monotonic() - self._stop_began < self._release_time:
            return "Cannot unlock protective stop until 5s after occurrence"
        self.unlock_protective_stop()
        return "Protective stop releasing"
