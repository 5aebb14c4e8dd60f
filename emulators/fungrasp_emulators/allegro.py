"""An Allegro Hand on a CAN bus: "virtual" in a process, "loopback" between processes."""

from __future__ import annotations

import struct
import time
from typing import Any

import numpy as np

from fungrasp.robots.device import import_client
from fungrasp.robots.hands import allegro_bus as codec
from fungrasp.robots.hands.allegro_bus import BUS_ERROR, BUS_OFF, LOOPBACK, open_can_bus
from fungrasp_emulators.emulator import COMMON, Emulator, Fault, Plant, PlantCommand

NO_BUFFERS = 0x1FFFFFFE
"""As in ``fungrasp_emulators.loopback_can_bus``, which needs python-can."""

BUS = "43113"
"""Default channel of "loopback"; a second hand has one of its own, "43114"."""


WARM, HOT = 35, 85
"""Temperatures that the hand says [°C]."""

FULL, FULL_EVERY = 20, 0.2
"""For how long the host's queue is full [ms], and how often [s]."""

SILENT = (Fault.STALLED, Fault.POWER_LOSS, Fault.BUS_OFF)
"""Faults in which nothing is heard and nothing sent."""


class AllegroEmulator(Emulator):
    """Sends positions at the period it is told and drives its plant with the torques it receives."""

    supported = COMMON | {
        Fault.DOUBLED,
        Fault.POWER_LOSS,
        Fault.SATURATED,
        Fault.BUS_ERRORS,
        Fault.BUS_OFF,
        Fault.TOO_HOT,
        Fault.INTERNAL,
        Fault.UNHEARD,
        Fault.NO_BUFFERS,
    }

    def __init__(
        self,
        plant: Plant,
        interface: str = LOOPBACK,
        channel: str = BUS,
        generation: int = 4,
        side: str = "right",
        device: int = 0,
        seed: int = 0,
    ):
        """plant: sixteen joints, in the order of the bus. seed: of the frames that faults take. Else as in
        ``AllegroSettings``."""
        super().__init__()
        self.plant = plant
        self._interface, self._channel = interface, channel
        self._units = codec.ALLEGRO_V4 if generation == 4 else codec.ALLEGRO_V5
        self._side, self._device = side, device
        self._rng = np.random.default_rng(seed)
        self._can: Any = None
        self._bus: Any = None
        self._period = 0.0
        self._servos_on = False
        self._torques = np.zeros(16)
        self._held: list[tuple[int, bytes]] = []
        self._full_due = 0.0

    @property
    def servos_on(self) -> bool:
        """Whether the host has switched the servos on."""
        return self._servos_on

    @property
    def torques(self) -> np.ndarray:
        """Torques last received [N m], shape [16]."""
        return self._torques.copy()

    def start(self) -> None:
        self._can = import_client("can", "allegro", "the Allegro emulator")
        self._bus = open_can_bus(self._interface, self._channel)
        self._ended.clear()
        self._run(self._serve)

    def close(self) -> None:
        self._end_threads()
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def inject(self, fault: Fault) -> None:
        """See ``Emulator.inject``; after a power loss the servos are off."""
        super().inject(fault)
        if fault is Fault.POWER_LOSS:
            self._servos_on, self._period = False, 0.0
        if fault is Fault.BUS_OFF:
            self._send_error(BUS_OFF)

    def fill_buffers(self, milliseconds: int) -> None:
        """The host's adapter takes no frame for so long [ms]; on "loopback" only."""
        data = milliseconds.to_bytes(4, "little")
        self._bus.send(self._can.Message(arbitration_id=NO_BUFFERS, data=data, is_extended_id=True))

    def _serve(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            now = time.monotonic()
            if self._period and now >= due:
                # Frames that the machine was too busy to send are not sent later in a burst.
                due = max(due + self._period, now)
                self._send_positions(now)
            wait = due - time.monotonic() if self._period else 0.01
            if self.shows(Fault.NO_BUFFERS) and now >= self._full_due:
                self._full_due = now + FULL_EVERY
                self.fill_buffers(FULL)
            message = self._bus.recv(min(max(wait, 0.0), 0.01))
            if message is not None and message.arbitration_id & 3 == self._device:
                self._take(message)

    def _take(self, message: Any) -> None:
        code, data = codec.code_of(message.arbitration_id), bytes(message.data)
        if any(map(self.shows, SILENT)):
            # A hand without power hears nothing; a stalled one keeps its last torques.
            if self.shows(Fault.POWER_LOSS):
                self.plant.apply(PlantCommand(), time.monotonic())
            return
        if self.shows(Fault.UNHEARD) and not message.is_remote_frame and self._rng.random() < 0.2:
            return
        finger = code - codec.TORQUE
        if message.is_remote_frame:
            self._answer(code)
        elif 0 <= finger < codec.FINGERS_ON_BUS and len(data) == 8:
            torques = np.frombuffer(data, "<i2") / self._units.counts_per_torque[4 * finger : 4 * finger + 4]
            self._torques[4 * finger : 4 * finger + 4] = torques
            if finger == codec.FINGERS_ON_BUS - 1:
                self._drive()
        elif code in (codec.SERVOS_ON, codec.SERVOS_OFF):
            self._servos_on = code == codec.SERVOS_ON
            self._drive()
        elif code == codec.PERIODS:
            self._period = 1e-3 * int.from_bytes(data[:2], "little")

    def _drive(self) -> None:
        command = PlantCommand(torques=self._torques.copy()) if self._servos_on else PlantCommand()
        self.plant.apply(command, time.monotonic())

    def _answer(self, code: int) -> None:
        wrong = self.shows(Fault.WRONG_DEVICE)
        left = (self._side == "left") != wrong
        if code == codec.INFO:
            hot = self.shows(Fault.TOO_HOT)
            status = self._servos_on | hot << 1 | self.shows(Fault.INTERNAL) << 2
            temperature = HOT if hot else WARM
            hardware = self._units.number << 8
            self._send(code, struct.pack("<HHBBB", hardware, 0x0100, left, temperature, status))
        elif code == codec.SERIAL:
            self._send(code, b"50A" + (b"L" if left else b"R") + b"0001")

    def _send_positions(self, now: float) -> None:
        if any(map(self.shows, SILENT)):
            return
        positions = self.plant.state(now).positions
        counts = np.clip(np.rint(positions / self._units.radians_per_count), -32767, 32767)
        data = counts.astype("<i2").tobytes()
        frames = [(codec.POSITION + f, data[8 * f : 8 * f + 8]) for f in range(codec.FINGERS_ON_BUS)]
        for code, data in self._disturbed(frames):
            self._send(code, data)
            if self.shows(Fault.BUS_ERRORS) and self._rng.random() < 0.1:
                self._send_error(BUS_ERROR)

    def _disturbed(self, frames: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
        if self.shows(Fault.SATURATED):
            return [(code, b"\xff\x7f" * 4) for code, _ in frames]
        chosen = self._rng.random(len(frames)) < 0.1
        if self.shows(Fault.CORRUPT):
            frames = [
                (c, self._rng.bytes(8) if bad else d) for (c, d), bad in zip(frames, chosen, strict=True)
            ]
        if self.shows(Fault.LOST):
            frames = [frame for frame, bad in zip(frames, chosen, strict=True) if not bad]
        if self.shows(Fault.DOUBLED):
            frames = [frame for frame in frames for _ in range(2)]
        if self.shows(Fault.LATE):
            late = [frame for frame, bad in zip(frames, chosen, strict=True) if bad]
            frames = self._held + [frame for frame, bad in zip(frames, chosen, strict=True) if not bad]
            self._held = late
        return frames

    def _send(self, code: int, data: bytes) -> None:
        message = self._can.Message(
            arbitration_id=codec.identifier(code, self._device), data=data, is_extended_id=False
        )
        self._bus.send(message)

    def _send_error(self, classes: int) -> None:
        """An error frame, as the host's own adapter makes it; its eight bytes are no positions."""
        self._bus.send(
            self._can.Message(
                arbitration_id=classes, data=bytes(8), is_extended_id=False, is_error_frame=True
            )
        )
