"""An Inspire RH56 hand: Modbus over TCP on the loopback, or Modbus or the maker's own protocol on a serial
line, a pseudo terminal.

A real hand's behavior is in it: it begins to move 66 ms after a command, at the speed that was measured for
each setting, and takes 6 ms for an answer (the time that published clients wait for one; it may be less).
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import selectors
import socket
import struct
import time
import tty
from collections.abc import Sequence
from typing import Any

import numpy as np

from fungrasp.robots.device import RobotError
from fungrasp.robots.hands import hand_joint_limits
from fungrasp.robots.hands import inspire_link as codec
from fungrasp_emulators import modbus
from fungrasp_emulators.emulator import COMMON, Emulator, Fault, Plant, PlantCommand

COMMAND_DELAY = 0.066
"""From a command to the first motion, median over a real hand's steps [s]."""
LEAVE = 65535
"""Written to a motor's angle: leave as it is."""
ANSWER_TIME = 0.006
"""Of a real hand [s]."""
LATE = 0.05
"""An answer that is late takes so much longer [s]."""
FAULTY, MOTOR_FAULT = 3, 1 << 3
"""The motor with a fault, the index finger's, and the bit that says so."""
BITS_PER_BYTE = 10


class InspireEmulator(Emulator):
    """Registers of a hand in front of a plant of six joints, in the order of the hand's model."""

    supported = COMMON | {
        Fault.KILLED,
        Fault.RESET,
        Fault.POWER_LOSS,
        Fault.SATURATED,
        Fault.FROZEN,
        Fault.REFUSED,
        Fault.UNHEARD,
        Fault.MOTOR,
    }

    def __init__(
        self,
        plant: Plant,
        address: str = "127.0.0.1",
        port: int = 6000,
        protocol: str = "tcp",
        hand: str = "inspire",
        device: int = 1,
        delay: float = COMMAND_DELAY,
        answer_time: float = ANSWER_TIME,
        baud: int = 115200,
        seed: int = 0,
    ):
        """
        Args:
            plant: six joints.
            address: of the loopback, for TCP.
            port: of TCP; 0: any that is free.
            protocol: "tcp" or, on a pseudo terminal, "rtu" (both Modbus) or "serial" (frames EB 90).
            hand: model of the hand: limits of the joints.
            device: number of the hand.
            delay: from a command to its effect [s].
            answer_time: of an answer [s].
            baud: a pseudo terminal has no line speed: answers wait as long as their bytes would take.
            seed: of the answers that faults take.
        """
        super().__init__()
        self.plant = plant
        self.address, self.port = address, port
        self._protocol, self._serial = protocol, protocol != "tcp"
        self._device, self._delay = device, delay
        self._answer_time, self._baud = answer_time, baud
        self._lower, self._upper = hand_joint_limits(hand, codec.MOTORS)
        self._rng = np.random.default_rng(seed)
        self._registers: dict[int, int] = {codec.HAND_ID: device}
        for motor in range(codec.MOTORS):
            self._registers |= {codec.SPEED_SET + motor: 1000, codec.FORCE_SET + motor: 500}
        self._pending: list[tuple[float, PlantCommand]] = []
        self._selector = selectors.DefaultSelector()
        self._server: socket.socket | None = None
        self._clients: dict[socket.socket, bytes] = {}
        self._terminal: tuple[int, int] | None = None
        self._stream = b""
        self._frozen: list[int] | None = None
        self.late = LATE
        """An answer that is late takes so much longer [s]."""
        self.unheard = 0
        """So many of the next writes do nothing and are not answered."""

    def start(self) -> None:
        """See ``Emulator.start``; ``address`` and ``port`` are then those to connect to."""
        self._ended.clear()
        if self._serial:
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._terminal, self.address = (master, slave), os.ttyname(slave)
            self._selector.register(master, selectors.EVENT_READ)
        else:
            self._listen()
        self._run(self._serve)

    def close(self) -> None:
        self._end_threads()
        self._hang_up()
        if self._terminal is not None:
            self._selector.unregister(self._terminal[0])
            for end in self._terminal:
                os.close(end)
            self._terminal = None

    def inject(self, fault: Fault) -> None:
        super().inject(fault)
        if fault is Fault.MOTOR:
            self.report_error(FAULTY, MOTOR_FAULT)

    def report_error(self, motor: int, bits: int) -> None:
        """Set the error bits of a motor, 0 to 5."""
        values = codec.unpack_bytes([self._registers.get(codec.ERRORS + i, 0) for i in range(3)])
        values[motor] = bits
        for i in range(3):
            self._registers[codec.ERRORS + i] = values[2 * i] | values[2 * i + 1] << 8

    def _listen(self) -> None:
        try:
            self._server = socket.create_server((self.address, self.port))
        except OSError as error:
            raise RobotError(
                f"the Inspire emulator cannot listen on {self.address}:{self.port}: {error.strerror}"
            ) from error
        self.port = self._server.getsockname()[1]
        self._selector.register(self._server, selectors.EVENT_READ)

    def _hang_up(self, reset: bool = False) -> None:
        for client in list(self._clients):
            self._drop(client, reset)
        if self._server is not None and not reset:
            self._selector.unregister(self._server)
            self._server.close()
            self._server = None

    def _drop(self, client: socket.socket, reset: bool = False) -> None:
        if reset:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._selector.unregister(client)
        client.close()
        del self._clients[client]

    def _serve(self) -> None:
        while not self._ended.is_set():
            self._obey_faults()
            now = time.monotonic()
            while self._pending and self._pending[0][0] <= now:
                due, command = self._pending.pop(0)
                if not self.shows(Fault.POWER_LOSS):
                    self.plant.apply(command, due)
            wait = min(self._pending[0][0] - now if self._pending else 0.01, 0.01)
            for key, _ in self._selector.select(max(wait, 0.0)):
                if self._server is not None and key.fileobj is self._server:
                    client, _ = self._server.accept()
                    client.settimeout(0.2)
                    self._clients[client] = b""
                    self._selector.register(client, selectors.EVENT_READ)
                elif self._terminal is not None:
                    self._read_terminal()
                else:
                    self._read_socket(key.fileobj)

    def _obey_faults(self) -> None:
        gone = self.shows(Fault.KILLED) or self.shows(Fault.POWER_LOSS)
        if self.shows(Fault.POWER_LOSS):
            self.plant.apply(PlantCommand(), time.monotonic())
        if not self._serial and gone and self._server is not None:
            self._hang_up()
        elif not self._serial and not gone and self._server is None:
            self._listen()
        if self.shows(Fault.RESET):
            self._hang_up(reset=True)
            self._active = self._active - {Fault.RESET}

    def _read_terminal(self) -> None:
        assert self._terminal is not None
        with contextlib.suppress(BlockingIOError, OSError):
            self._stream += os.read(self._terminal[0], 4096)
        if self._protocol == "serial":
            requests, self._stream = codec.split_frames(codec.REQUEST, self._stream)
            for request in requests:
                self._send_serial(codec.encode_frame(codec.REQUEST, request), self._own_answer(request))
            return
        requests, self._stream = modbus.split_serial_requests(self._stream)
        for device, data in requests:
            answer = self._answer(device, data)
            frame = None if answer is None else modbus.serial_frame(device, answer)
            self._send_serial(modbus.serial_frame(device, data), frame)

    def _send_serial(self, request: bytes, answer: bytes | None) -> None:
        if answer is not None:
            assert self._terminal is not None
            frame = self._disturbed(answer)
            time.sleep(BITS_PER_BYTE * (len(request) + len(frame)) / self._baud)
            os.write(self._terminal[0], frame)

    def _read_socket(self, client: Any) -> None:
        try:
            data = client.recv(4096)
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        requests, self._clients[client] = modbus.split_tcp_requests(self._clients[client] + data)
        for transaction, device, content in requests:
            answer = self._answer(device, content)
            if answer is None:
                continue
            try:
                client.sendall(self._disturbed(modbus.tcp_frame(transaction, device, answer)))
            except OSError:
                self._drop(client)
                return

    def _own_answer(self, request: codec.InspireFrame) -> bytes | None:
        if not self._answers(request.device):
            return None
        if request.command == codec.READ:
            count = (request.data[0] + 1) // 2
            data = codec.register_bytes(self._values(request.address, count))[: request.data[0]]
        elif request.command == codec.WRITE:
            if self._misses_write():
                return None
            if not self.shows(Fault.REFUSED):
                self._write(request.address, codec.registers_of(request.data))
            data = bytes([not self.shows(Fault.REFUSED)])
        else:
            return None
        return codec.encode_frame(codec.ANSWER, dataclasses.replace(request, data=data))

    def _answer(self, device: int, data: bytes) -> bytes | None:
        if not self._answers(device):
            return None
        request = modbus.decode_request(data)
        if request.function == modbus.READ:
            return modbus.encode_answer(request, tuple(self._values(request.address, request.count)))
        if request.function in (modbus.WRITE, modbus.WRITE_ONE):
            if self._misses_write():
                return None
            if self.shows(Fault.REFUSED):
                return modbus.refusal(request)
            self._write(request.address, request.values)
        return modbus.encode_answer(request)

    def _misses_write(self) -> bool:
        missed = self.unheard > 0 or (self.shows(Fault.UNHEARD) and self._rng.random() < 0.2)
        self.unheard = max(self.unheard - 1, 0)
        return missed

    def _answers(self, device: int) -> bool:
        """Whether a request is answered; takes the time that the hand takes."""
        silent = (Fault.STALLED, Fault.KILLED, Fault.POWER_LOSS)
        if device != self._device or any(self.shows(fault) for fault in silent):
            return False
        if self.shows(Fault.LOST) and self._rng.random() < 0.1:
            return False
        time.sleep(self._answer_time)
        if self.shows(Fault.LATE) and self._rng.random() < 0.1:
            time.sleep(self.late)
        return True

    def _disturbed(self, frame: bytes) -> bytes:
        if self.shows(Fault.CORRUPT) and self._rng.random() < 0.1:
            # The last bytes: over TCP values, on a serial line what the checksum covers.
            return frame[:-4] + self._rng.bytes(4)
        return frame

    def _values(self, address: int, count: int) -> list[int]:
        if address == codec.HAND_ID and self.shows(Fault.WRONG_DEVICE):
            return [self._device + 1] * count
        if address == codec.ANGLE_ACTUAL:
            if self.shows(Fault.SATURATED):
                return [0x7FFF] * count
            if not self.shows(Fault.FROZEN) or self._frozen is None:
                positions = self.plant.state(time.monotonic()).positions
                self._frozen = codec.encode_angles(positions, self._lower, self._upper)
            return self._frozen[:count]
        return [self._registers.get(address + i, 0) for i in range(count)]

    def _write(self, first: int, values: Sequence[int]) -> None:
        for address, value in enumerate(values, first):
            known = self._registers.get(address, 0)
            leave = value == LEAVE and codec.ANGLE_SET <= address < codec.FORCE_SET
            self._registers[address] = known if leave else value
        if first == codec.CLEAR_ERRORS:
            self._registers |= {codec.ERRORS + i: 0 for i in range(3)}
        if first == codec.ANGLE_SET:
            angles = [self._registers[codec.ANGLE_SET + i] for i in range(codec.MOTORS)]
            speeds = codec.signed([self._registers[codec.SPEED_SET + i] for i in range(codec.MOTORS)])
            share = codec.closing_speed(speeds[codec.MODEL_ORDER]) / codec.OPEN_ANGLE
            goal = codec.decode_angles(angles, self._lower, self._upper)
            if self.shows(Fault.MOTOR):
                joint = int(codec.MODEL_ORDER[FAULTY])
                goal[joint] = self.plant.state(time.monotonic()).positions[joint]
            command = PlantCommand(positions=goal, velocity_limits=share * (self._upper - self._lower))
            self._pending.append((time.monotonic() + self._delay, command))
