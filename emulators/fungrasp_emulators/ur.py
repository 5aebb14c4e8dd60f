"""The controller of a UR arm: RTDE, dashboard, scripts and its kinematics on one address of the loopback.

Enough of it for the client library ur_rtde: its program is "uploaded" (taken, not interpreted), and the
commands that this program would read from the input registers are carried out. Ports are fixed, so several
controllers take several addresses, 127.0.0.2, 127.0.0.3, ...; on 127.0.0.1 the client skips its check of
remote control.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from enum import IntEnum

import numpy as np

from fungrasp.robots.device import RobotError
from fungrasp_emulators import rtde as codec
from fungrasp_emulators.emulator import COMMON, Emulator, Fault, Plant
from fungrasp_emulators.ur_kinematics import UR5, UR5E, tool_pose
from fungrasp_emulators.ur_program import ServoProgram

RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORT = 30004, 29999, 30003
STATE = "output_int_register_0"
STOPPED, PLAYING = 1, 2
CLOCK_JUMP = 3600.0
"""By so much the clock is set forward, and back when the fault ends [s]."""
RELEASE_TIME = 5.0
"""A real controller unlocks a protective stop 5 s after it happened at the earliest [s]."""


class SafetyBit(IntEnum):
    """Bits of the controller's safety status."""

    NORMAL = 0
    PROTECTIVE_STOP = 2
    SAFEGUARD_STOP = 4
    ROBOT_EMERGENCY_STOP = 6
    EMERGENCY_STOP = 7
    STOPPED = 10


class URControllerEmulator(Emulator):
    """A controller with a program of ur_rtde; ``servoj`` goes to the plant as it comes."""

    supported = COMMON | {
        Fault.KILLED,
        Fault.RESET,
        Fault.DOUBLED,
        Fault.PROTECTIVE_STOP,
        Fault.EMERGENCY_STOP,
        Fault.SAFEGUARD_STOP,
        Fault.FROZEN,
        Fault.CLOCK_JUMP,
    }

    def __init__(
        self,
        plant: Plant,
        address: str = "127.0.0.2",
        version: tuple[int, int, int] = (5, 11, 0),
        model: str = "UR5",
        serial: str = "20205500001",
        seed: int = 0,
        release_time: float = RELEASE_TIME,
        tool: tuple[float, ...] = (0.0,) * 6,
    ):
        """
        Args:
            version: of the controller's software; 3 is a CB3 controller (125 Hz) with a UR5, 5 an e-Series
                (500 Hz) with a UR5e.
            model: "UR3", "UR5", "UR10", ...
            seed: of the packages that faults take.
            release_time: a protective stop can't be unlocked before [s].
            tool: the tool center point on the flange, position [m] and rotation vector [rad].
        """
        super().__init__()
        self.plant = plant
        self.address = address
        self.payload, self.payload_center = 0.0, (0.0, 0.0, 0.0)
        """What the pendant says that the arm carries: mass [kg] and its center from the flange [m]."""
        self._version, self._model, self._serial = version, model, serial
        self._period = 0.008 if version[0] < 5 else 0.002
        self._tool = np.array(tool)
        self._kinematics = UR5 if version[0] < 5 else UR5E
        self._release_time = release_time
        self._rng = np.random.default_rng(seed)
        self._net = codec.URConnections(address, (RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORT), self._greet)
        self._other_program = False
        self._program = ServoProgram(plant, self._tool)
        self._stop_began = 0.0
        self._origin = time.monotonic()
        self._frozen_time: float | None = None

    @property
    def program_running(self) -> bool:
        """Whether the client's program runs."""
        return self._program.running

    @property
    def other_program_running(self) -> bool:
        """Whether somebody else's program runs that was running before."""
        return self._other_program

    def play_other_program(self) -> None:
        """What a person does at the pendant: a program runs that is not ours, until another one starts."""
        self._other_program = True

    def set_speed_slider(self, share: float) -> None:
        """What a person does at the pendant; share: 0 to 1."""
        self._program.slider = share

    def start(self) -> None:
        self._ended.clear()
        try:
            self._net.listen()
        except OSError as error:
            self._net.hang_up()
            raise RobotError(f"the UR emulator cannot listen on {self.address}: {error.strerror}") from error
        self._run(self._serve)

    def close(self) -> None:
        self._end_threads()
        self._net.hang_up()

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

    def _serve(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            if self.shows(Fault.STALLED):
                time.sleep(0.001)
                continue
            self._obey_faults()
            for client in self._net.receive(max(0.0, due - time.monotonic())):
                self._take(client)
            now = time.monotonic()
            if now >= due:
                due = max(due + self._period, now)
                self._tick(now)

    def _obey_faults(self) -> None:
        if self.shows(Fault.KILLED) and self._net.listening:
            self._net.hang_up()
            self._program.stop()
        elif not self.shows(Fault.KILLED) and not self._net.listening:
            self._net.listen()
        if self.shows(Fault.RESET):
            for client in list(self._net.clients):
                self._net.drop(client, reset=True)
            self._program.stop()
            self._active = self._active - {Fault.RESET}
        if self.shows(Fault.PROTECTIVE_STOP) or self.shows(Fault.EMERGENCY_STOP):
            self._program.stop()
        if self.shows(Fault.SAFEGUARD_STOP):
            self._program.pause()
        else:
            self._program.paused = False

    def _greet(self, client: codec.URClient) -> None:
        if client.kind == DASHBOARD_PORT:
            self._net.send(client, b"Connected: Universal Robots Dashboard Server\n")

    def _take(self, client: codec.URClient) -> None:
        if client.kind == RTDE_PORT:
            packages, client.received = codec.split_packages(client.received)
            for kind, content in packages:
                try:
                    self._take_package(client, kind, content)
                except (IndexError, KeyError, struct.error):
                    # As a real controller does with what it can't read.
                    self._net.drop(client)
                    return
        elif client.kind == DASHBOARD_PORT:
            *lines, client.received = client.received.split(b"\n")
            for line in lines:
                self._net.send(client, self._dashboard(line.decode().strip()).encode() + b"\n")
        elif client.received.endswith(b"\nend\n"):
            client.received = b""
            self._start_program()

    def _take_package(self, client: codec.URClient, kind: bytes, content: bytes) -> None:
        if kind == codec.DATA:
            recipe = client.inputs[content[0] - 1]
            self._program.take(codec.decode_values(recipe, content[1:]))
        elif kind == codec.PROTOCOL_VERSION:
            self._net.send(client, codec.package(kind, b"\x01"))
        elif kind == codec.CONTROLLER_VERSION:
            self._net.send(client, codec.package(kind, struct.pack(">4I", *self._version, 1)))
        elif kind == codec.SETUP_OUTPUTS:
            client.outputs = codec.make_recipe(content[8:].decode())
            client.interval = 1.0 / max(struct.unpack(">d", content[:8])[0], 1.0)
            self._net.send(client, codec.package(kind, b"\x01" + ",".join(client.outputs.types).encode()))
        elif kind == codec.SETUP_INPUTS:
            recipe = codec.make_recipe(content.decode())
            others = {n for c in self._net.clients if c is not client for r in c.inputs for n in r.names}
            types = ["IN_USE" if n in others else t for n, t in zip(recipe.names, recipe.types, strict=True)]
            number = b"\0"
            if not others.intersection(recipe.names):
                client.inputs.append(recipe)
                number = bytes([len(client.inputs)])
            self._net.send(client, codec.package(kind, number + ",".join(types).encode()))
        elif kind in (codec.START, codec.PAUSE):
            client.started = kind == codec.START
            self._net.send(client, codec.package(kind, b"\x01"))

    def _start_program(self) -> None:
        if self.shows(Fault.PROTECTIVE_STOP) or self.shows(Fault.EMERGENCY_STOP):
            return
        self._other_program = False
        self._program.start()

    def _tick(self, now: float) -> None:
        self._program.watch(now)
        if not any(client.started for client in self._net.clients):
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
            "target_q": state.positions if self._program.goal is None else self._program.goal,
            "target_moment": state.torques,
            "runtime_state": PLAYING if self.program_running or self._other_program else STOPPED,
            "payload": self.payload,
            "payload_cog": self.payload_center,
            "speed_scaling": 1.0,
            "target_speed_fraction": self._program.slider,
            "robot_mode": 7,
            "safety_mode": 3 if self.shows(Fault.PROTECTIVE_STOP) else 7 if stopped else 1,
            "robot_status_bits": 1 | self.program_running << 1,
            "safety_status_bits": self._safety_bits(),
            STATE: self._program.answer,
            **{f"output_double_register_{i}": value for i, value in enumerate(self._program.outputs)},
        }
        for client in list(self._net.clients):
            if client.started and client.outputs is not None and client.outputs.valid and now >= client.due:
                if "actual_TCP_pose" in client.outputs.names and "actual_TCP_pose" not in values:
                    # Not for every tick: it takes longer than all the rest.
                    values["actual_TCP_pose"] = tool_pose(self._kinematics, state.positions, self._tool)
                client.due = max(client.due + client.interval, now)
                self._net.send(
                    client, self._disturbed(client, codec.encode_values(client.outputs, 1, values))
                )

    def _safety_bits(self) -> int:
        bits = {SafetyBit.NORMAL}
        if self.shows(Fault.PROTECTIVE_STOP):
            bits = {SafetyBit.PROTECTIVE_STOP, SafetyBit.STOPPED}
        if self.shows(Fault.SAFEGUARD_STOP):
            bits = {SafetyBit.SAFEGUARD_STOP, SafetyBit.STOPPED}
        if self.shows(Fault.EMERGENCY_STOP):
            bits = {SafetyBit.ROBOT_EMERGENCY_STOP, SafetyBit.EMERGENCY_STOP, SafetyBit.STOPPED}
        return sum(1 << bit for bit in bits)

    def _disturbed(self, client: codec.URClient, data: bytes) -> bytes:
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
        if self.shows(Fault.SAFEGUARD_STOP):
            return "SAFEGUARD_STOP"
        return "PROTECTIVE_STOP" if self.shows(Fault.PROTECTIVE_STOP) else "NORMAL"

    def _stopped_by_dashboard(self) -> str:
        self._program.stop()
        self._other_program = False
        return "Stopped"

    def _unlocked_by_dashboard(self) -> str:
        if time.monotonic() - self._stop_began < self._release_time:
            return "Cannot unlock protective stop until 5s after occurrence"
        self.unlock_protective_stop()
        return "Protective stop releasing"
