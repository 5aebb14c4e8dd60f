"""Driver of the LEAP hand: sixteen Dynamixel servos (XC330, XL330) with current-based position control.
Registers and units are from the manufacturer's e-Manual."""

from __future__ import annotations

import contextlib
import struct
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError, import_client
from fungrasp.robots.hands import PolledHand, hand_joint_limits, next_setpoint

MODEL_NUMBER, OPERATING_MODE, CURRENT_LIMIT, TORQUE_ENABLE, HARDWARE_ERROR = 0, 11, 38, 64, 70
D_GAIN, I_GAIN, P_GAIN, GOAL_CURRENT, GOAL_POSITION = 80, 82, 84, 102, 116
PRESENT_CURRENT = 126
PRESENT = struct.Struct("<hii")
"""Current, velocity and position, consecutive from ``PRESENT_CURRENT`` on."""
CURRENT_BASED_POSITION = 5
"""Operating mode: position control with a current limit."""

RADIANS_PER_COUNT = 2 * np.pi / 4096
CENTER = 2048
"""Count at the middle of a servo's range, the zero of the hand's joints."""
SPEED_PER_COUNT = 0.229 * 2 * np.pi / 60
"""Unit of velocities [rad/s]."""
AMPERES_PER_COUNT = 0.001
TORQUES_PER_AMPERE = {"full": 0.52, "lite": 0.35}
"""Torque constants by build of the hand [N m/A], from the stall points at 5 V in the data sheets: XC330-M288,
0.93 N m at 1.8 A; XL330-M288, 0.52 N m at 1.47 A."""

HARDWARE_ERRORS = {0: "input voltage", 2: "too hot", 3: "encoder", 4: "electrical shock", 5: "overload"}
"""Bits of the register HARDWARE_ERROR; with one of them, a servo has no torque until it is rebooted."""

SERVOS = 16
CURRENT_LIMITS = {"full": 550, "lite": 350}
"""Current limits of the manufacturer's examples, by build [mA]."""
SIDE_JOINTS, SIDE_SHARE = (0, 4, 8), 0.75
"""Servos that move fingers sideways, and their share of the gains, as in the manufacturer's examples."""
TORQUE, MODE, FULL_CURRENT, CURRENT = "torque", "operating mode", "current limit", "goal current"
GAIN_I, GAIN_P, GAIN_D = "I gain", "P gain", "D gain"
WRITTEN = {
    TORQUE: (TORQUE_ENABLE, 1),
    MODE: (OPERATING_MODE, 1),
    FULL_CURRENT: (CURRENT_LIMIT, 2),
    CURRENT: (GOAL_CURRENT, 2),
    GAIN_I: (I_GAIN, 2),
    GAIN_P: (P_GAIN, 2),
    GAIN_D: (D_GAIN, 2),
}
"""Address and size of written registers. They are read back, as servos do not acknowledge group writes."""
ERROR_INTERVAL = 0.5
"""Time between two readings of hardware errors [s]."""
LARGEST_JUMP = 0.3
"""Change of a position, beyond that at ``LARGEST_SPEED``, which makes it implausible [rad]."""
LARGEST_SPEED = 15.0
"""Almost twice the speed of the servos without load [rad/s]."""


def position_counts(positions: np.ndarray) -> list[int]:
    """Convert joint positions [rad], shape [U], to counts."""
    return [int(c) for c in np.rint(positions / RADIANS_PER_COUNT) + CENTER]


def joint_positions_of(counts: np.ndarray) -> np.ndarray:
    """Convert counts to joint positions [rad], shape [U]."""
    return (np.asarray(counts) - CENTER) * RADIANS_PER_COUNT


@dataclass(frozen=True)
class LeapSettings:
    """Connection and control of a LEAP hand."""

    port: str = "/dev/ttyUSB0"
    """Serial port."""
    baud: int = 4_000_000
    """Baud rate of the port [bit/s]."""
    hand: str = "leap"
    """Model of the hand, whose joints have the numbers of their servos as names."""
    p_gain: int = 600
    """P gain of the servos' position control, by default that of the manufacturer's examples."""
    d_gain: int = 200
    """D gain of the servos' position control."""
    build: str = ""
    """"full" or "lite", which have different motors; required."""
    current_limit: int = 0
    """Current limit of a servo [mA]; 0: that of the manufacturer's examples, 550 (full) or 350 (lite)."""
    speed: float = 4.0
    """Largest speed of the setpoints [rad/s]."""
    period: float = 0.02
    """Time between two readings [s]. The bus allows 90 readings of one quantity per second, 30 of three."""
    stale_after: float = 0.15
    """Silence after which the hand counts as disconnected [s]."""

    def __post_init__(self) -> None:
        if self.build not in CURRENT_LIMITS:
            raise RobotError(
                f'the build of a LEAP hand must be given as \'build\', "full" or "lite", not "{self.build}"'
            )
        if not 0 <= self.current_limit <= 1750:
            raise RobotError(f"current_limit of a LEAP hand is up to 1750 mA, not {self.current_limit}")

    @property
    def current(self) -> int:
        """Current limit of a servo [mA]."""
        return self.current_limit or CURRENT_LIMITS[self.build]


class LeapLoop(PolledHand):
    """Control loop of a LEAP hand."""

    def __init__(self, settings: LeapSettings):
        self.settings = settings
        self.name = f"LEAP hand at {settings.port}"
        self.stale_after = settings.stale_after
        self.lets_go = "when a servo is overloaded or too hot, and switches itself off"
        from fungrasp.hands import load_hand

        lower, upper = hand_joint_limits(settings.hand, SERVOS)
        names = load_hand(settings.hand).actuators
        if sorted(names) != sorted(map(str, range(SERVOS))):
            raise RobotError(
                f"the joints of hand '{settings.hand}' are not named by the numbers of LEAP's servos"
            )
        self._servos = [int(name) for name in names]
        self._torque_per_count = AMPERES_PER_COUNT * TORQUES_PER_AMPERE[settings.build]
        torque = settings.current * self._torque_per_count
        self.limits = JointLimits(lower, upper, np.full(SERVOS, settings.speed), np.full(SERVOS, torque))
        self._sdk: Any = None
        self._port: Any = None
        self._packets: Any = None
        self._writer: Any = None
        self._setpoint: np.ndarray | None = None
        super().__init__(settings.period, self._write)

    def torque_limit(self, share: float) -> LeapLoop:
        """Return a limited loop for the same hand (``LoopDriver.torque_limit``)."""
        return LeapLoop(replace(self.settings, current_limit=round(share * self.settings.current)))

    def open(self) -> None:
        """See ``DeviceLoop.open``. All sixteen servos must answer."""
        self._open_port()
        self._make_packets()
        for servo in self._servos:
            results = (self._packets.ping(self._port, servo)[1] for _ in range(3))
            if self._sdk.COMM_SUCCESS not in results:
                raise RobotError(
                    f"{self.name}: servo {servo} does not answer; check power, cable and baud rate"
                )
        for _ in range(5):
            if self._read_state() is not None:
                self._due = time.monotonic()
                return
        raise RobotError(f"{self.name}: the servos answer, but send no positions")

    def take_control(self) -> None:
        """See ``DeviceLoop.take_control``. Modes, limits and gains can only be set without torque."""
        self._taken = True
        if self._powered:
            return
        self._put(TORQUE, 0, anew=True)
        self._writes.finish(self.name)
        self._put_settings()
        self._writes.finish(self.name)

    def resume(self, positions: np.ndarray) -> None:
        """See ``DeviceLoop``. The servos go to the last goal and hold there."""
        self._taken = True
        self._setpoint = np.clip(positions, self.limits.lower, self.limits.upper)
        self._put(TORQUE, 1)

    def recover(self) -> None:
        """See ``DeviceLoop``. If servos were switched off, the torque stays off, and this is a fault."""
        with contextlib.suppress(Exception):
            self._port.closePort()
        self._open_port()
        self._make_packets()
        self._state = None
        if self._read_state() is None:
            raise RobotError(f"{self.name}: no positions")
        if self._powered and b"\0" in (self._read_all(*WRITTEN[TORQUE]) or ()):
            self._put(TORQUE, 0, anew=True)
            self._setpoint, self._fault = None, "servos were switched off"

    def halt(self) -> None:
        """See ``DeviceLoop.halt``. The servos keep their last setpoint and the current limit."""

    def close(self) -> None:
        with contextlib.suppress(Exception):
            self._port.closePort()

    @property
    def _powered(self) -> bool:
        """Whether the servos should have torque."""
        return 1 in (self._writes.wanted(TORQUE) or ())

    def _put(self, what: str, value: int, anew: bool = False) -> None:
        self._writes.put(what, (value,) * SERVOS, anew)

    def _put_settings(self) -> None:
        s = self.settings
        self._put(MODE, CURRENT_BASED_POSITION)
        self._put(FULL_CURRENT, s.current)
        self._put(CURRENT, s.current)
        self._put(GAIN_I, 0)
        for name, gain in ((GAIN_P, s.p_gain), (GAIN_D, s.d_gain)):
            side = round(SIDE_SHARE * gain)
            self._writes.put(name, tuple(side if n in SIDE_JOINTS else gain for n in self._servos), anew=True)

    def _make_packets(self) -> None:
        self._packets = self._sdk.PacketHandler(2.0)
        self._writer = self._sdk.GroupSyncWrite(self._port, self._packets, GOAL_POSITION, 4)

    def _open_port(self) -> None:
        self._sdk = import_client("dynamixel_sdk", "leap", "a LEAP hand")
        self._port = self._sdk.PortHandler(self.settings.port)
        try:
            if not self._port.setBaudRate(self.settings.baud):
                raise RobotError(f"{self.name}: the port has no {self.settings.baud} bit/s")
            # Another program on the same port would receive half of the answers.
            self._port.ser.exclusive = True
        except OSError as error:
            raise RobotError(f"{self.name}: cannot open the port: {error}") from error
        # The library polls without pause: a short timeout leaves the processor to others.
        self._port.ser.timeout = 0.002

    def _move(self, goal: LoopGoal, state: JointState, elapsed: float) -> None:
        step = min(elapsed, 2 * self.settings.period)
        self._setpoint = next_setpoint(self._setpoint, goal, state.positions, self.limits, step)
        if self._setpoint is None:
            if goal.mode is LoopMode.POWER_OFF:
                self._put(TORQUE, 0)
            return
        self._writer.clearParam()
        for servo, counts in zip(self._servos, position_counts(self._setpoint), strict=True):
            self._writer.addParam(servo, struct.pack("<i", counts))
        self._send(self._writer.txPacket)
        # After the first setpoint, as a servo moves to its goal when its torque is switched on.
        self._put(TORQUE, 1)

    def _read_state(self) -> JointState | None:
        data = self._read_all(PRESENT_CURRENT, PRESENT.size)
        if data is None:
            return None
        rows = [PRESENT.unpack(d) for d in data]
        current, velocity, counts = np.array(rows, dtype=float).T
        positions, now, before = joint_positions_of(counts), time.monotonic(), self._state
        if before is not None:
            largest = LARGEST_JUMP + LARGEST_SPEED * (now - before.received)
            if np.abs(positions - before.positions).max() > largest:
                return None
        if now >= self._errors_due:
            self._errors_due = now + ERROR_INTERVAL
            self._fault = self._read_faults()
        status = DeviceStatus.FAULT if self._fault else DeviceStatus.READY
        torques = current * self._torque_per_count
        speeds = velocity * SPEED_PER_COUNT
        self._state = JointState(positions, speeds, torques, now, now, status, self._fault)
        return self._state

    def _read_faults(self) -> str:
        """Return the fault of a servo, as a phrase; the previous one without answer."""
        # Of a length that no other reading has (see ``_read_all``).
        errors = self._read_all(HARDWARE_ERROR, 4)
        if errors is None:
            return self._fault
        for servo, error in zip(self._servos, errors, strict=True):
            for bit, what in HARDWARE_ERRORS.items():
                if error[0] >> bit & 1:
                    return f"servo {servo}: {what}; switch the hand off and on"
        return ""

    def _read_all(self, address: int, size: int) -> list[bytes] | None:
        """Read bytes from every servo; None if not all answer. Answers have the servo and a length, but no
        register, so late answers are told by their length, which the library does not compare."""
        found, packet = [], []
        try:
            self._packets.syncReadTx(self._port, address, size, self._servos, SERVOS, False)
            for servo in self._servos:
                while packet[4:7] != [servo, size + 4, 0]:
                    packet, result = self._packets.rxPacket(self._port, False)
                    if result != self._sdk.COMM_SUCCESS:
                        return None
                found.append(bytes(packet[9 : 9 + size]))
        except (OSError, TypeError) as error:
            # pyserial raises TypeError if its port was closed meanwhile.
            raise RobotError(f"{self.name}: the port is gone: {error}") from error
        return found

    def _write(self, what: str, values: tuple[int, ...]) -> bool:
        """Write a register of every servo; return whether all values are read back."""
        address, size = WRITTEN[what]
        writer = self._sdk.GroupSyncWrite(self._port, self._packets, address, size)
        for servo, value in zip(self._servos, values, strict=True):
            writer.addParam(servo, value.to_bytes(size, "little"))
        self._send(writer.txPacket)
        return self._read_all(address, size) == [value.to_bytes(size, "little") for value in values]

    def _send(self, send: Any) -> None:
        try:
            send()
        except (OSError, TypeError) as error:
            raise RobotError(f"{self.name}: the port is gone: {error}") from error
