"""LEAP hand: sixteen Dynamixel servos with position control and a limit of current."""

from __future__ import annotations

import contextlib
import struct
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.robots.codecs import dynamixel as codec
from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError
from fungrasp.robots.hands.joint_order import hand_joint_limits, hand_joint_names
from fungrasp.robots.optional_packages import import_client

SERVOS = 16
CURRENT_LIMITS = {"full": 550, "lite": 350}
"""Of the maker's examples, by build [mA]."""
SIDE_JOINTS, SIDE_SHARE = (0, 4, 8), 0.75
"""Servos that move fingers sideways, and the share of the gains that the maker's examples give them."""
OPEN_SPEED = 0.5
"""Of opening after a fault [rad/s]."""
ERROR_INTERVAL = 0.5
"""Hardware errors are read so often [s]."""
LARGEST_JUMP = 0.3
"""Beyond what ``LARGEST_SPEED`` explains, a position this far from the last is not believed [rad]."""
LARGEST_SPEED = 15.0
"""[rad/s]; the servos' speed without load is 8."""


@dataclass(frozen=True)
class LeapSettings:
    """How a LEAP hand is connected and controlled."""

    port: str = "/dev/ttyUSB0"
    """Serial port."""
    baud: int = 4_000_000
    """Of the port [bit/s]."""
    hand: str = "leap"
    """Model of the hand; its joints are named by the numbers of their servos."""
    p_gain: int = 600
    """Of the servos' position control, as the maker's examples set it."""
    d_gain: int = 200
    """Of the servos' position control."""
    build: str = ""
    """"full" or "lite", which have other motors: must be said."""
    current_limit: int = 0
    """Highest current of a servo [mA]; 0: as the maker's examples set it, 550 for the full hand, 350 for the
    lite one."""
    speed: float = 4.0
    """Highest speed of the setpoints [rad/s]."""
    period: float = 0.02
    """Between reads [s]: the hand's bus gives up to 90 reads of one quantity per second, 30 of three."""
    stale_after: float = 0.15
    """Silence after which the hand counts as disconnected [s]."""

    def __post_init__(self) -> None:
        if self.build not in CURRENT_LIMITS:
            raise RobotError(f'the build of a LEAP hand must be said, "full" or "lite", not "{self.build}"')
        if not 0 <= self.current_limit <= 1750:
            raise RobotError(f"current_limit of a LEAP hand is up to 1750 mA, not {self.current_limit}")

    @property
    def current(self) -> int:
        """Highest current of a servo [mA]."""
        return self.current_limit or CURRENT_LIMITS[self.build]


def leap_driver(settings: LeapSettings, process: bool = True) -> LoopDriver:
    """Driver of a LEAP hand; process: talk to it from a process of its own."""
    return LoopDriver(LeapLoop(settings), process=process)


class LeapLoop:
    """``DeviceLoop`` of a LEAP hand."""

    def __init__(self, settings: LeapSettings):
        """
        Args:
            settings: how the hand is connected and controlled.
        """
        self.settings = settings
        self.name = f"LEAP hand at {settings.port}"
        self.stale_after = settings.stale_after
        self.takes_feedforward = False
        self.lets_go = "when a servo is overloaded or too hot, and switches itself off"
        lower, upper = hand_joint_limits(settings.hand, SERVOS)
        names = hand_joint_names(settings.hand)
        if sorted(names) != sorted(map(str, range(SERVOS))):
            raise RobotError(
                f"the joints of hand '{settings.hand}' are not named by the numbers of LEAP's servos"
            )
        self._servos = [int(name) for name in names]
        torque = settings.current * codec.AMPERES_PER_COUNT * codec.TORQUE_PER_AMPERE
        self.limits = JointLimits(lower, upper, np.full(SERVOS, settings.speed), np.full(SERVOS, torque))
        self._sdk: Any = None
        self._port: Any = None
        self._packets: Any = None
        self._reader: Any = None
        self._writer: Any = None
        self._state: JointState | None = None
        self._setpoint: np.ndarray | None = None
        self._powered = False
        self._due = self._errors_due = 0.0
        self._fault = ""

    def torque_limit(self, share: float) -> LeapLoop:
        """See ``LoopDriver.torque_limit``: the same hand, not opened."""
        return LeapLoop(replace(self.settings, current_limit=round(share * self.settings.current)))

    def open(self) -> None:
        """See ``DeviceLoop.open``: all sixteen servos must answer."""
        self._open_port()
        self._reader = self._sdk.GroupSyncRead(
            self._port, self._packets, codec.PRESENT_CURRENT, codec.PRESENT.size
        )
        self._writer = self._sdk.GroupSyncWrite(self._port, self._packets, codec.GOAL_POSITION, 4)
        for servo in self._servos:
            results = (self._packets.ping(self._port, servo)[1] for _ in range(3))
            if self._sdk.COMM_SUCCESS not in results:
                raise RobotError(
                    f"{self.name}: servo {servo} does not answer; check power, cable and baud rate"
                )
            self._reader.addParam(servo)
        for _ in range(5):
            if self._read() is not None:
                self._due = time.monotonic()
                return
        raise RobotError(f"{self.name}: the servos answer, but send no positions")

    def take_control(self) -> None:
        """See ``DeviceLoop.take_control``: modes, limits and gains can be set without torque only."""
        if self._powered:
            return
        self._write_all(codec.TORQUE_ENABLE, 1, 0)
        self._write_all(codec.OPERATING_MODE, 1, codec.CURRENT_BASED_POSITION)
        self._write_all(codec.CURRENT_LIMIT, 2, self.settings.current)
        self._write_all(codec.GOAL_CURRENT, 2, self.settings.current)
        self._write_all(codec.I_GAIN, 2, 0)
        for address, gain in ((codec.P_GAIN, self.settings.p_gain), (codec.D_GAIN, self.settings.d_gain)):
            self._write_all(address, 2, gain)
            self._write_all(address, 2, round(SIDE_SHARE * gain), SIDE_JOINTS)

    def step(self, goal: LoopGoal) -> JointState:
        """See ``DeviceLoop.step``."""
        rest = self._due - time.monotonic()
        if rest > 0:
            time.sleep(rest)
        self._due = max(self._due, time.monotonic() - self.settings.period) + self.settings.period
        before = self._state
        state = self._read()
        if state is None:
            assert before is not None
            if time.monotonic() - before.received > self.settings.stale_after:
                raise RobotError(f"{self.name}: no positions for {1e3 * self.settings.stale_after:.0f} ms")
            return before
        if state.status is DeviceStatus.READY:
            self._move(goal, state, state.received - before.received if before else self.settings.period)
        elif goal.mode is LoopMode.IDLE:
            # Somebody has connected anew after a fault.
            self._fault, self._errors_due = "", 0.0
        return state

    def halt(self) -> None:
        """See ``DeviceLoop.halt``: the servos keep their last setpoint and its limit of current."""

    def close(self) -> None:
        """See ``DeviceLoop.close``."""
        with contextlib.suppress(Exception):
            self._port.closePort()

    def rescue(self) -> None:
        """See ``DeviceLoop.rescue``: nothing to do, the servos keep their last setpoint."""

    def _open_port(self) -> None:
        self._sdk = import_client("dynamixel_sdk", "leap", "a LEAP hand")
        self._port = self._sdk.PortHandler(self.settings.port)
        try:
            if not self._port.setBaudRate(self.settings.baud):
                raise RobotError(f"{self.name}: the port has no {self.settings.baud} bit/s")
            # Another program on the same port would take half of the answers.
            self._port.ser.exclusive = True
        except OSError as error:
            raise RobotError(f"{self.name}: cannot open the port: {error}") from error
        # The library polls without a pause; a read that may wait a little leaves the processor to others.
        self._port.ser.timeout = 0.002
        self._packets = self._sdk.PacketHandler(2.0)

    def _move(self, goal: LoopGoal, state: JointState, elapsed: float) -> None:
        if goal.mode is LoopMode.POWER_OFF:
            self._setpoint = None
            if self._powered:
                self._write_all(codec.TORQUE_ENABLE, 1, 0)
                self._powered = False
            return
        if self._setpoint is None:
            if goal.mode in (LoopMode.IDLE, LoopMode.STAND_BY):
                return
            self._setpoint = np.clip(state.positions, self.limits.lower, self.limits.upper)
        wanted, speed = self._setpoint, self.settings.speed
        if goal.mode is LoopMode.FOLLOW:
            wanted = goal.positions
        elif goal.mode is LoopMode.OPEN:
            wanted, speed = np.clip(np.zeros(SERVOS), self.limits.lower, self.limits.upper), OPEN_SPEED
        largest = speed * min(elapsed, 2 * self.settings.period)
        self._setpoint = self._setpoint + np.clip(wanted - self._setpoint, -largest, largest)
        self._writer.clearParam()
        for servo, counts in zip(self._servos, codec.position_counts(self._setpoint), strict=True):
            self._writer.addParam(servo, struct.pack("<i", counts))
        self._send(self._writer.txPacket)
        if not self._powered:
            # After the first setpoint: a servo runs to whatever goal it has when its torque is switched on.
            self._write_all(codec.TORQUE_ENABLE, 1, 1)
            self._powered = True

    def _read(self) -> JointState | None:
        try:
            result = self._reader.txRxPacket()
        except (OSError, TypeError) as error:
            # pyserial raises TypeError where its port was closed under it.
            raise RobotError(f"{self.name}: the port is gone: {error}") from error
        data = [bytes(self._reader.data_dict[servo]) for servo in self._servos]
        # The library calls an answer of another length a success, too.
        if result != self._sdk.COMM_SUCCESS or any(len(d) != codec.PRESENT.size for d in data):
            with contextlib.suppress(OSError):
                self._port.clearPort()
            return None
        rows = [codec.PRESENT.unpack(d) for d in data]
        current, velocity, counts = np.array(rows, dtype=float).T
        positions, now, before = codec.joint_positions_of(counts), time.monotonic(), self._state
        if before is not None:
            largest = LARGEST_JUMP + LARGEST_SPEED * (now - before.received)
            if np.abs(positions - before.positions).max() > largest:
                return None
        if now >= self._errors_due:
            self._errors_due = now + ERROR_INTERVAL
            self._fault = self._read_faults()
        status = DeviceStatus.FAULT if self._fault else DeviceStatus.READY
        torques = current * codec.AMPERES_PER_COUNT * codec.TORQUE_PER_AMPERE
        speeds = velocity * codec.SPEED_PER_COUNT
        self._state = JointState(positions, speeds, torques, now, now, status, self._fault)
        return self._state

    def _read_faults(self) -> str:
        reader = self._sdk.GroupSyncRead(self._port, self._packets, codec.HARDWARE_ERROR, 1)
        for servo in self._servos:
            reader.addParam(servo)
        if reader.txRxPacket() != self._sdk.COMM_SUCCESS:
            return ""
        for servo in self._servos:
            bits = reader.getData(servo, codec.HARDWARE_ERROR, 1)
            for bit, what in codec.HARDWARE_ERRORS.items():
                if bits >> bit & 1:
                    return f"servo {servo}: {what}; switch the hand off and on"
        return ""

    def _write_all(
        self, address: int, size: int, value: int, servos: tuple[int, ...] = tuple(range(SERVOS))
    ) -> None:
        writer = self._sdk.GroupSyncWrite(self._port, self._packets, address, size)
        for servo in servos:
            writer.addParam(servo, value.to_bytes(size, "little"))
        self._send(writer.txPacket)

    def _send(self, send: Any) -> None:
        try:
            send()
        except (OSError, TypeError) as error:
            raise RobotError(f"{self.name}: the port is gone: {error}") from error
