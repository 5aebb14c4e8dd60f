"""A chain of Dynamixel servos on a pseudo terminal, as in a LEAP hand, and the packets of their protocol 2.0.

    FF FF FD 00  id  length (2)  instruction  parameters  CRC-16 (2)

Numbers are little endian. Where parameters hold the bytes FF FF FD, one more FD is sent. Facts from the
maker's e-Manual. Drivers use dynamixel-sdk; the packets here are the other side's, of different make.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import time
import tty
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.robots.device import RobotError
from fungrasp.robots.hands import leap as codec
from fungrasp_emulators.emulator import COMMON, Emulator, Fault, Plant, PlantCommand

PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE = 0x82, 0x83
BROADCAST = 0xFE
START = b"\xff\xff\xfd\x00"


@dataclass(frozen=True)
class ServoPacket:
    """An instruction or a status."""

    device: int
    """Number of the servo; ``BROADCAST`` for all."""
    instruction: int
    """What to do."""
    parameters: bytes
    """Of the instruction; a status begins with an error byte."""


def encode_packet(packet: ServoPacket) -> bytes:
    """Bytes of a packet."""
    content = bytes([packet.instruction]) + packet.parameters.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = START + struct.pack("<BH", packet.device, len(content) + 2)
    return head + content + struct.pack("<H", packet_checksum(head + content))


def split_servo_packets(stream: bytes) -> tuple[list[ServoPacket], bytes]:
    """Whole packets in a stream, and what may be the start of another; bytes that are none are skipped."""
    packets = []
    while True:
        at = stream.find(START)
        if at < 0:
            return packets, stream[-(len(START) - 1) :]
        stream = stream[at:]
        if len(stream) < 7:
            return packets, stream
        size = 7 + struct.unpack("<H", stream[5:7])[0]
        if len(stream) < size:
            return packets, stream
        if (
            size >= 10
            and packet_checksum(stream[: size - 2]) == struct.unpack("<H", stream[size - 2 : size])[0]
        ):
            parameters = stream[8 : size - 2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            packets.append(ServoPacket(stream[4], stream[7], parameters))
            stream = stream[size:]
        else:
            stream = stream[1:]


def packet_checksum(data: bytes) -> int:
    """CRC-16 with the polynomial 0x8005, high bit first, start 0."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


MODEL = 1220
"""Model number of an XC330-M288."""
OVERLOAD = 1 << 5
"""Of the hardware errors; a servo with one has no torque."""
REGISTERS = 150
BITS_PER_BYTE = 10


class DynamixelEmulator(Emulator):
    """Servos 0, 1, ... with a plant of as many joints; joint i of the plant is servo ``servos[i]``."""

    supported = COMMON | {
        Fault.KILLED,
        Fault.DOUBLED,
        Fault.POWER_LOSS,
        Fault.SATURATED,
        Fault.FROZEN,
        Fault.UNHEARD,
        Fault.MOTOR,
        Fault.WRAPPED,
    }

    def __init__(
        self,
        plant: Plant,
        servos: tuple[int, ...] = tuple(range(16)),
        baud: int = 4_000_000,
        seed: int = 0,
        path: str = "",
        build: str = "full",
    ):
        """
        Args:
            path: a link to the terminal, to connect to; "" for none.
            build: of the hand, whose motors it has: "full" or "lite".
            baud: a pseudo terminal has no line speed: answers wait as long as their bytes would take [bit/s].
            seed: of the answers that faults take.
        """
        super().__init__()
        self.plant = plant
        self.address = ""
        """Path of the terminal to connect to."""
        self._servos, self._baud = servos, baud
        self._link = Path(path) if path else None
        self._torque_per_ampere = codec.TORQUES_PER_AMPERE[build]
        self._rng = np.random.default_rng(seed)
        self._memory = {servo: bytearray(REGISTERS) for servo in servos}
        for memory in self._memory.values():
            memory[codec.MODEL_NUMBER : codec.MODEL_NUMBER + 2] = MODEL.to_bytes(2, "little")
        self._terminal: tuple[int, int] | None = None
        self._stream, self._held = b"", b""
        self._frozen: list[tuple[int, int, int]] | None = None

    @property
    def torque_on(self) -> bool:
        """Whether every servo has torque."""
        return all(memory[codec.TORQUE_ENABLE] for memory in self._memory.values())

    def start(self) -> None:
        self._ended.clear()
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._terminal, self.address = (master, slave), os.ttyname(slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.address)
            self.address = str(self._link)
        self._run(self._serve)

    def close(self) -> None:
        self._end_threads()
        if self._terminal is not None:
            if self._link is not None:
                self._link.unlink(missing_ok=True)
            for end in self._terminal:
                os.close(end)
            self._terminal = None

    def inject(self, fault: Fault) -> None:
        """See ``Emulator.inject``; servos without power have no torque and lose their goals."""
        super().inject(fault)
        if fault is Fault.POWER_LOSS:
            for memory in self._memory.values():
                memory[codec.TORQUE_ENABLE] = 0
            self.plant.apply(PlantCommand(), time.monotonic())
        if fault is Fault.MOTOR:
            self.report_error(self._servos[0], OVERLOAD)
            self._memory[self._servos[0]][codec.TORQUE_ENABLE] = 0
            self._drive(codec.TORQUE_ENABLE)

    def register(self, servo: int, address: int) -> int:
        """Two bytes of a servo's memory, without a sign."""
        return int.from_bytes(self._memory[servo][address : address + 2], "little")

    def report_error(self, servo: int, bits: int) -> None:
        """Set the hardware error bits of a servo."""
        self._memory[servo][codec.HARDWARE_ERROR] = bits

    def _serve(self) -> None:
        assert self._terminal is not None
        master = self._terminal[0]
        while not self._ended.is_set():
            if not select.select([master], [], [], 0.01)[0]:
                continue
            with contextlib.suppress(BlockingIOError, OSError):
                self._stream += os.read(master, 4096)
            packets, self._stream = split_servo_packets(self._stream)
            for packet in packets:
                answer = b"".join(map(self._disturbed, self._answers(packet)))
                if answer:
                    time.sleep(BITS_PER_BYTE * (len(packet.parameters) + 10 + len(answer)) / self._baud)
                    os.write(master, answer)

    def _answers(self, packet: ServoPacket) -> list[bytes]:
        if any(self.shows(fault) for fault in (Fault.STALLED, Fault.KILLED, Fault.POWER_LOSS)):
            return []
        data = packet.parameters
        if packet.instruction == SYNC_WRITE:
            address, size = struct.unpack("<HH", data[:4])
            misses = self.shows(Fault.UNHEARD) and self._rng.random() < 0.2
            deaf = self._servos[self._rng.integers(len(self._servos))] if misses else None
            for at in range(4, len(data), size + 1):
                if data[at] == deaf:
                    continue
                self._write(data[at], address, data[at + 1 : at + 1 + size])
            self._drive(address)
            return []
        if packet.instruction == SYNC_READ:
            address, size = struct.unpack("<HH", data[:4])
            self._measure()
            return [self._status(servo, self._memory[servo][address : address + size]) for servo in data[4:]]
        servo = packet.device
        if servo not in self._memory or (self.shows(Fault.WRONG_DEVICE) and servo == self._servos[-1]):
            return []
        if packet.instruction == PING:
            return [self._status(servo, MODEL.to_bytes(2, "little") + b"\x30")]
        if packet.instruction == READ:
            address, size = struct.unpack("<HH", data[:4])
            self._measure()
            return [self._status(servo, self._memory[servo][address : address + size])]
        if packet.instruction == WRITE:
            self._write(servo, struct.unpack("<H", data[:2])[0], data[2:])
            self._drive(struct.unpack("<H", data[:2])[0])
            return [self._status(servo, b"")]
        return []

    def _status(self, servo: int, data: bytes | bytearray) -> bytes:
        return encode_packet(ServoPacket(servo, STATUS, b"\x00" + bytes(data)))

    def _write(self, servo: int, address: int, data: bytes) -> None:
        if servo not in self._memory or address + len(data) > REGISTERS:
            raise RobotError(f"a write to servo {servo}, address {address} came, which there is not")
        memory = self._memory[servo]
        if address < codec.TORQUE_ENABLE and memory[codec.TORQUE_ENABLE]:
            # Modes and limits can be set without torque only.
            return
        if address == codec.TORQUE_ENABLE and memory[codec.HARDWARE_ERROR]:
            return
        memory[address : address + len(data)] = data

    def _drive(self, address: int) -> None:
        if address not in (codec.GOAL_POSITION, codec.TORQUE_ENABLE):
            return
        now = time.monotonic()
        powered = np.array([bool(self._memory[servo][codec.TORQUE_ENABLE]) for servo in self._servos])
        if not powered.any():
            self.plant.apply(PlantCommand(), now)
            return
        goals = [struct.unpack_from("<i", self._memory[s], codec.GOAL_POSITION)[0] for s in self._servos]
        positions = np.where(
            powered, codec.joint_positions_of(np.array(goals)), self.plant.state(now).positions
        )
        limits = [struct.unpack_from("<H", self._memory[s], codec.GOAL_CURRENT)[0] for s in self._servos]
        torques = np.array(limits) * codec.AMPERES_PER_COUNT * self._torque_per_ampere
        self.plant.apply(PlantCommand(positions=positions, torque_limits=torques), now)

    def _measure(self) -> None:
        if self._frozen is None or not self.shows(Fault.FROZEN):
            state = self.plant.state(time.monotonic())
            current = state.torques / self._torque_per_ampere / codec.AMPERES_PER_COUNT
            rows = np.rint([current, state.velocities / codec.SPEED_PER_COUNT]).astype(int).T.tolist()
            counts = codec.position_counts(state.positions)
            self._frozen = [(c, v, p) for (c, v), p in zip(rows, counts, strict=True)]
        for servo, (current, velocity, position) in zip(self._servos, self._frozen, strict=True):
            position = 0x7FFFFFFF if self.shows(Fault.SATURATED) else position
            if self.shows(Fault.WRAPPED) and servo == self._servos[0]:
                position += 4096
            current = int(np.clip(current, -32768, 32767))
            codec.PRESENT.pack_into(self._memory[servo], codec.PRESENT_CURRENT, current, velocity, position)

    def _disturbed(self, answer: bytes) -> bytes:
        # Sixteen answers make one reading: one in a hundred of them, one in seven readings.
        chosen = self._rng.random() < 0.01
        if chosen and self.shows(Fault.LOST):
            return b""
        if chosen and self.shows(Fault.CORRUPT):
            return answer[:-6] + self._rng.bytes(6)
        if self.shows(Fault.DOUBLED):
            return answer + answer
        if chosen and self.shows(Fault.LATE):
            time.sleep(0.03)
        return answer
