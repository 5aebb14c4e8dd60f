"""Driver of the Inspire RH56 over Modbus (TCP or serial line) or the manufacturer's serial protocol.

The hand has position servos: a goal is written once. It begins to move about 66 ms after a command.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError
from fungrasp.robots.hands import PolledHand, hand_joint_limits
from fungrasp.robots.hands import inspire_link as codec

ERROR_INTERVAL = 0.2
"""Time between two readings of errors [s]; they change slowly, and a reading takes a real hand 6 ms."""
OPEN_SPEED_SETTING = 250
"""Speed setting of opening after a stop: full stroke in about 1.5 s."""
HOLD_AHEAD, HOLD_STILL = 0.1, 6
"""Time [s], and largest motion of a resting motor within it [angle units]."""
SERIAL_PROTOCOLS = ("serial", "rtu")
"""Protocols on a serial port."""
ANGLE_TOLERANCE = 50
"""Distance from the range 0 to 1000 beyond which an angle is implausible."""
CLEARING, SPEEDS, FORCES, ANGLES = "clearing of errors", "speed limits", "force limits", "angles"
WRITTEN = {
    CLEARING: codec.CLEAR_ERRORS,
    SPEEDS: codec.SPEED_SET,
    FORCES: codec.FORCE_SET,
    ANGLES: codec.ANGLE_SET,
}
"""Addresses of written values. All writes are acknowledged; limits are also read back."""


@dataclass(frozen=True)
class InspireSettings:
    """Connection of an Inspire hand, and its limits of speed and force."""

    address: str = "192.168.11.210"
    """Address of the hand, or a serial port ("/dev/ttyUSB0"). All hands are delivered with this address."""
    port: int = 6000
    """TCP port."""
    baud: int = 115200
    """Baud rate of a serial port [bit/s]."""
    protocol: str = ""
    """Network: "tcp" (Modbus), the default. Serial port: "serial" (the manufacturer's protocol, frames EB 90)
    or "rtu" (Modbus), depending on how the hand was ordered; there is no default."""
    device: int = 1
    """Number of the hand (register HAND_ID); any other is refused."""
    hand: str = "inspire"
    """Model of the hand, with the limits of the joints. The hand does not report its side."""
    speed: int = 500
    """Speed setting, 1 to 1000. At higher speeds the force overshoots: a limit of 500 g peaks at 1700 g."""
    force: int = 500
    """Force limit of a finger [g], 1 to 1000."""
    period: float = 0.02
    """Time between two readings [s]; a real hand answers in 6 ms."""
    answer_timeout: float = 0.1
    """Longest wait for an answer [s]."""
    stale_after: float = 0.25
    """Silence after which the hand counts as disconnected [s]."""

    def __post_init__(self) -> None:
        for name, value in (("speed", self.speed), ("force", self.force)):
            if not 0 < value <= 1000:
                raise RobotError(f"{name} of an Inspire hand is 1 to 1000, not {value}")
        serial = self.address.startswith(("/", "COM"))
        known = SERIAL_PROTOCOLS if serial else ("tcp",)
        if self.protocol not in known and (serial or self.protocol):
            given = f"is not '{self.protocol}'" if self.protocol else "is missing"
            raise RobotError(
                f"'protocol' {given}: an Inspire hand at '{self.address}' speaks "
                + ('"serial" (frames EB 90) or "rtu" (Modbus)' if serial else '"tcp"')
            )


class InspireLoop(PolledHand):
    """Control loop of an Inspire hand."""

    def __init__(self, settings: InspireSettings):
        self.settings = settings
        # Several hands may share an address, with different ports.
        port = "" if settings.port == InspireSettings.port else f":{settings.port}"
        self.name = f"Inspire RH56 at {settings.address}{port}"
        self.stale_after = settings.stale_after
        lower, upper = hand_joint_limits(settings.hand, codec.MOTORS)
        self._range = upper - lower
        speed = codec.closing_speed(settings.speed) / codec.OPEN_ANGLE * self._range
        # The hand takes no torques; the model has its largest ones.
        self.limits = JointLimits(lower, upper, speed, np.full(codec.MOTORS, np.inf))
        self._link: codec.InspireLink | None = None
        self._sent: list[int] | None = None
        self._mode = LoopMode.IDLE
        super().__init__(settings.period, self._write)

    def torque_limit(self, share: float) -> InspireLoop:
        """Return a limited loop for the same hand (``LoopDriver.torque_limit``)."""
        return InspireLoop(replace(self.settings, force=max(1, round(share * self.settings.force))))

    def open(self) -> None:
        s = self.settings
        try:
            self._link = codec.open_link(s.address, s.port, s.baud, s.protocol, s.device, s.answer_timeout)
        except RobotError as error:
            raise RobotError(f"{self.name}: {error}") from error
        number = self._first_answer(codec.HAND_ID, 1)[0] & 0xFF
        if number != s.device:
            raise RobotError(f"{self.name}: the hand says that it is number {number}, not {s.device}")
        self._first_answer(codec.ANGLE_ACTUAL, codec.MOTORS)
        self._due = time.monotonic()

    def take_control(self) -> None:
        self._taken = True
        self._writes.put(CLEARING, [1], anew=True)
        self._put_limits(self.settings.speed)
        self._writes.finish(self.name)

    def resume(self, positions: np.ndarray) -> None:
        """See ``DeviceLoop``. The hand has kept its goal, and its grip."""
        self._taken = True
        self._put_limits(self.settings.speed)

    def _acknowledge(self) -> None:
        if self._taken:
            self._writes.put(CLEARING, [1], anew=True)
            self._writes.work()

    def recover(self) -> None:
        """See ``DeviceLoop``. Unconfirmed values and the limits are written again. A hand that was switched
        off stays where it is."""
        assert self._link is not None, "open() comes first"
        self._link.close()
        if not self._link.connect() or self._read(codec.ANGLE_ACTUAL, codec.MOTORS) is None:
            raise RobotError(f"{self.name}: no answer")
        self._state = None
        self._writes.forget(SPEEDS, FORCES)
        if self._mode is LoopMode.OPEN:
            # So that the next step writes it again.
            self._mode = LoopMode.HOLD

    def halt(self) -> bool:
        """See ``DeviceLoop.halt``. Squeezing fingers go on, others stop; the drives hold without power."""
        try:
            if self._state is not None and self._mode in (LoopMode.FOLLOW, LoopMode.OPEN):
                self._hold(self._state)
                self._mode = LoopMode.HOLD
            self._writes.work()
        except Exception:
            return False
        return ANGLES not in self._writes.missing

    def close(self) -> None:
        if self._link is not None:
            self._link.close()

    def _put_limits(self, speed: int) -> None:
        self._writes.put(SPEEDS, [speed] * codec.MOTORS)
        self._writes.put(FORCES, [self.settings.force] * codec.MOTORS)

    def _move(self, goal: LoopGoal, state: JointState, elapsed: float) -> None:
        """See ``PolledHand``. A faulted hand gets commands as well."""
        faulted = state.status is not DeviceStatus.READY
        if goal.mode is LoopMode.FOLLOW:
            self._put_limits(self.settings.speed)
            self._goto(codec.encode_angles(goal.positions, self.limits.lower, self.limits.upper))
        elif goal.mode is LoopMode.OPEN and self._mode is not LoopMode.OPEN:
            if faulted:
                # Motors with an error may not move until it is cleared.
                self._writes.put(CLEARING, [1], anew=True)
            self._put_limits(OPEN_SPEED_SETTING)
            self._goto([codec.OPEN_ANGLE] * codec.MOTORS, anew=True)
        elif goal.mode in (LoopMode.HOLD, LoopMode.POWER_OFF) and self._mode is LoopMode.FOLLOW:
            self._hold(state)
        self._mode = goal.mode

    def _goto(self, angles: list[int], anew: bool = False) -> None:
        self._sent = angles
        self._writes.put(ANGLES, angles, anew)

    def _hold(self, state: JointState) -> None:
        """Stop moving fingers; fingers that an object has stopped keep squeezing it."""
        angles = codec.encode_angles(state.positions, self.limits.lower, self.limits.upper)
        if self._mode is LoopMode.FOLLOW and self._sent is not None:
            # In the order of the motors.
            moving = codec.encode_angles(
                state.positions + HOLD_AHEAD * state.velocities, self.limits.lower, self.limits.upper
            )
            still = [abs(a - b) <= HOLD_STILL for a, b in zip(moving, angles, strict=True)]
            angles = [s if rest else a for s, rest, a in zip(self._sent, still, angles, strict=True)]
        self._goto(angles)

    def _read_state(self) -> JointState | None:
        registers = self._read(codec.ANGLE_ACTUAL, codec.MOTORS)
        now, before = time.monotonic(), self._state
        if registers is None:
            return None
        angles = codec.signed(registers)
        if angles.min() < -ANGLE_TOLERANCE or angles.max() > codec.OPEN_ANGLE + ANGLE_TOLERANCE:
            return None
        positions = codec.decode_angles(registers, self.limits.lower, self.limits.upper)
        velocities = np.zeros(codec.MOTORS)
        if before is not None:
            velocities = (positions - before.positions) / max(now - before.received, 1e-3)
        if now >= self._errors_due:
            self._errors_due = now + ERROR_INTERVAL
            # Values have no checksum over TCP and a weak one on a serial line: faults are read twice.
            said = self._read_faults()
            self._fault = _faults_in_words(said) if said is not None and said == self._read_faults() else ""
        status = DeviceStatus.FAULT if self._fault else DeviceStatus.READY
        self._state = JointState(positions, velocities, None, now, now, status, self._fault)
        return self._state

    def _read_faults(self) -> list[int] | None:
        """Read the fault bits by motor, without those of grasping; None without fault or answer."""
        registers = self._read(codec.ERRORS, codec.MOTORS // 2)
        if registers is None:
            return None
        mask = sum(1 << bit for bit in codec.FAULTS)
        faults = [bits & mask for bits in codec.unpack_bytes(registers)]
        return faults if any(faults) else None

    def _first_answer(self, address: int, count: int) -> Sequence[int]:
        for _ in range(5):
            registers = self._read(address, count)
            if registers is not None:
                return registers
        raise RobotError(
            f"{self.name}: connected, but no answers; check device number, baud rate and protocol"
        )

    def _read(self, address: int, count: int) -> Sequence[int] | None:
        assert self._link is not None, "open() comes first"
        return self._link.read(address, count)

    def _write(self, what: str, values: list[int]) -> bool:
        assert self._link is not None, "open() comes first"
        if not self._link.write(WRITTEN[what], values):
            return False
        return what not in (SPEEDS, FORCES) or list(self._read(WRITTEN[what], len(values)) or ()) == values


def _faults_in_words(faults: list[int]) -> str:
    """Return the first fault, as a phrase. faults: bits by motor, at least one of them set."""
    names = ("little finger", "ring finger", "middle finger", "index finger", "thumb bend", "thumb rotation")
    motor = next(motor for motor, bits in enumerate(faults) if bits)
    return f"{names[motor]}: {next(what for bit, what in codec.FAULTS.items() if faults[motor] >> bit & 1)}"
