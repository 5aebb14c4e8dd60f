"""Inspire RH56 over Modbus, TCP or a serial line, or the maker's own serial protocol.

The hand has position servos of its own: a goal is written once, at the speed and force that were set on
connecting. It begins to move about 66 ms after a command.
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
"""Errors are read so often [s]; they change slowly, and every read takes a real hand 6 ms."""
OPEN_SPEED_SETTING = 250
"""Of opening after a fault: full stroke in about 1.5 s."""
HOLD_AHEAD, HOLD_STILL = 0.1, 6
"""A motor that moves by no more than so many units within so long [s] stands still."""
SERIAL_PROTOCOLS = ("serial", "rtu")
"""Protocols on a serial port."""
ANGLE_TOLERANCE = 50
"""Angles outside 0 to 1000 by more are not believed."""
CLEARING, SPEEDS, FORCES, ANGLES = "clearing of errors", "speed limits", "force limits", "angles"
WRITTEN = {
    CLEARING: codec.CLEAR_ERRORS,
    SPEEDS: codec.SPEED_SET,
    FORCES: codec.FORCE_SET,
    ANGLES: codec.ANGLE_SET,
}
"""What is written to the hand, and where. All is acknowledged; limits are read back, too."""


@dataclass(frozen=True)
class InspireSettings:
    """How an Inspire hand is connected and how fast and strong it may close."""

    address: str = "192.168.11.210"
    """Address of the hand, or a serial port ("/dev/ttyUSB0"). Hands are delivered with the same address."""
    port: int = 6000
    """Of TCP."""
    baud: int = 115200
    """Of a serial port."""
    protocol: str = ""
    """"tcp", Modbus over a network, is meant where nothing is said; on a serial port one of two must be said:
    "serial", the maker's own with frames EB 90, or "rtu", Modbus. A hand speaks one of them, as it was
    ordered."""
    device: int = 1
    """Number of the hand (its register HAND_ID); another one is refused."""
    hand: str = "inspire"
    """Model of the hand: limits of the joints. The hand does not say its side."""
    speed: int = 500
    """0 to 1000. At higher speeds the fingers overshoot the force that is set: 500 g peak at 1700 g."""
    force: int = 500
    """Highest force of a finger [g]."""
    period: float = 0.02
    """Between reads [s]; a real hand answers in 6 ms."""
    answer_timeout: float = 0.1
    """An answer that takes longer is lost [s]."""
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
    """Of an Inspire hand."""

    def __init__(self, settings: InspireSettings):
        """settings: how the hand is connected."""
        self.settings = settings
        # Several hands may be reached through one computer, each at a port of its own.
        port = "" if settings.port == InspireSettings.port else f":{settings.port}"
        self.name = f"Inspire RH56 at {settings.address}{port}"
        self.stale_after = settings.stale_after
        lower, upper = hand_joint_limits(settings.hand, codec.MOTORS)
        self._range = upper - lower
        speed = codec.closing_speed(settings.speed) / codec.OPEN_ANGLE * self._range
        # The hand takes no torques; what it can give is in the model.
        self.limits = JointLimits(lower, upper, speed, np.full(codec.MOTORS, np.inf))
        self._link: codec.InspireLink | None = None
        self._sent: list[int] | None = None
        self._mode = LoopMode.IDLE
        super().__init__(settings.period, self._write)

    def torque_limit(self, share: float) -> InspireLoop:
        """See ``LoopDriver.torque_limit``: the same hand, not opened."""
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
        """See ``DeviceLoop``: the hand has its goal, and whatever it squeezes stays squeezed."""
        self._taken = True
        self._put_limits(self.settings.speed)

    def _acknowledge(self) -> None:
        if self._taken:
            self._writes.put(CLEARING, [1], anew=True)
            self._writes.work()

    def recover(self) -> None:
        """See ``DeviceLoop``: what was on its way as the hand was lost is written again, and its limits. One
        that was switched off meanwhile stays where it is."""
        assert self._link is not None, "open() comes first"
        self._link.close()
        if not self._link.connect() or self._read(codec.ANGLE_ACTUAL, codec.MOTORS) is None:
            raise RobotError(f"{self.name}: no answer")
        self._state = None
        self._writes.forget(SPEEDS, FORCES)
        if self._mode is LoopMode.OPEN:
            # Told anew.
            self._mode = LoopMode.HOLD

    def halt(self) -> bool:
        """See ``DeviceLoop.halt``: fingers that squeeze go on, others stay; the drives hold without power."""
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
        """A faulted hand is told all the same."""
        faulted = state.status is not DeviceStatus.READY
        if goal.mode is LoopMode.FOLLOW:
            self._put_limits(self.settings.speed)
            self._goto(codec.encode_angles(goal.positions, self.limits.lower, self.limits.upper))
        elif goal.mode is LoopMode.OPEN and self._mode is not LoopMode.OPEN:
            if faulted:
                # Motors with an error may not move before it is cleared.
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
        """Fingers that move stay where they are; those that something holds up keep squeezing it."""
        angles = codec.encode_angles(state.positions, self.limits.lower, self.limits.upper)
        if self._mode is LoopMode.FOLLOW and self._sent is not None:
            # In the order of the hand's motors, as registers are.
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
            # Values have no checksum over TCP, a weak one on a serial line: a fault counts when the same is
            # read twice.
            said = self._read_faults()
            self._fault = _faults_in_words(said) if said is not None and said == self._read_faults() else ""
        status = DeviceStatus.FAULT if self._fault else DeviceStatus.READY
        self._state = JointState(positions, velocities, None, now, now, status, self._fault)
        return self._state

    def _read_faults(self) -> list[int] | None:
        """Bits of faults by motor, without those that belong to grasping; None where there is none, or nobody
        answers."""
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
    """The first of some faults, as a phrase. faults: bits by motor, of which at least one is set."""
    names = ("little finger", "ring finger", "middle finger", "index finger", "thumb bend", "thumb rotation")
    motor = next(motor for motor, bits in enumerate(faults) if bits)
    return f"{names[motor]}: {next(what for bit, what in codec.FAULTS.items() if faults[motor] >> bit & 1)}"
