"""Driver of the Allegro Hand V4 and V5 over CAN: torque control on the host, one step per set of positions.

torque = kp (setpoint - q) - kd v + feed-forward

The setpoint moves to the goal within the speed limit; v is the difference of positions through a first-order
low-pass. The hand sends positions every 3 ms by its own clock, so the loop runs at 333 Hz.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.robots.control_loop.device_loop import ConfirmedWrites, DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError, import_client
from fungrasp.robots.hands import allegro_bus as codec
from fungrasp.robots.hands import hand_joint_limits, next_setpoint

ANSWER_TIMEOUT = 1.0
"""Longest wait for an answer of the hand [s]."""
LARGEST_JUMP = 0.2
"""Change of a position, beyond that at ``LARGEST_SPEED``, which makes it implausible [rad]."""
LARGEST_SPEED = 20.0
"""Twice the speed of the hand without load [rad/s]."""
BEYOND = 0.5
"""Distance beyond the joint limits that makes a position implausible [rad]; zeros are off by less."""
JUMPS = 40
"""Number of consecutive implausible frames that is a fault of the hand: ten of each finger."""
LISTENING = 0.1
"""Time to wait for positions that another program has requested, before they are requested [s]."""
OTHERS = 0.1
"""Time after another program's torques in which it counts as controlling the hand [s]."""
INFO_INTERVAL = 1.0
"""Time between two requests of temperature and faults [s], which the hand sends only on request."""
CAN_WAIT = 0.002
"""Time after which a frame is dropped if the queue is full [s]; torques are sent again 3 ms later."""
SERVOS = "servos"
"""Name of the write that switches the servos on or off."""
SURE = 10
"""Number of commands after which the servos count as off, if the hand sends positions but no confirmation."""


@dataclass(frozen=True)
class AllegroSettings:
    """Connection and control of an Allegro Hand."""

    interface: str = "socketcan"
    """Interface of python-can: "socketcan", "pcan" ..., "loopback" (emulator), "virtual" (tests)."""
    channel: str = "can0"
    """Channel of the interface."""
    generation: int = 4
    """Generation, 4 or 5; any other than the hand's is refused."""
    side: str = "right"
    """"right" or "left"; any other than the hand's is refused."""
    hand: str = "allegro"
    """Model of the hand, with order and limits of the joints."""
    device: int = 0
    """Number set in the hand, 0 to 3."""
    period_ms: int = 3
    """Period at which the hand sends positions [ms]."""
    kp: float = 4.0
    """Stiffness [N m/rad]. Plans and policies are made for the model's, the default."""
    kd: float = 0.15
    """Damping [N m s/rad]; the model's by default."""
    velocity_filter: float = 0.01
    """Time constant of the velocities' low-pass [s]. Without it, one count of the V5 would be 0.5 rad/s, and
    its damping torque half of the largest."""
    speed: float = 4.0
    """Largest speed of the setpoints [rad/s]."""
    torque_share: float = 1.0
    """Largest torque as a share of the generation's, above 0 and at most 1."""
    stale_after: float = 0.05
    """Silence after which the hand counts as disconnected [s]."""
    bitrate: int = 1_000_000
    """Bit rate of the bus [bit/s]."""

    def __post_init__(self) -> None:
        if self.generation not in (4, 5):
            raise RobotError(f"the generation of an Allegro Hand is 4 or 5, not {self.generation}")
        if self.side not in ("right", "left"):
            raise RobotError(f'the side of a hand is "right" or "left", not "{self.side}"')
        if not 0 < self.torque_share <= 1:
            raise RobotError(f"torque_share is above 0 and at most 1, not {self.torque_share}")


class AllegroLoop(DeviceLoop):
    """Control loop of an Allegro Hand."""

    def __init__(self, settings: AllegroSettings):
        self.settings = settings
        self.name = (
            f"Allegro V{settings.generation} {settings.side} at {settings.interface}:{settings.channel}"
        )
        self.stale_after = settings.stale_after
        self.takes_feedforward = True
        self.lets_go = "when this program ends or the hand overheats, as this computer controls its torques"
        self._units = codec.ALLEGRO_V4 if settings.generation == 4 else codec.ALLEGRO_V5
        from fungrasp.hands import load_hand

        lower, upper = hand_joint_limits(settings.hand, 16)
        side = load_hand(settings.hand).side
        if side != settings.side:
            raise RobotError(
                f"{self.name}: side = \"{settings.side}\", but hand '{settings.hand}' is a model of a "
                f"{side} hand"
            )
        torque = settings.torque_share * self._units.torque_limits
        self.limits = JointLimits(lower, upper, np.full(16, settings.speed), torque)
        # Computed once, as each array operation counts in steps at 333 Hz.
        self._middle, self._believed = 0.5 * (lower + upper), 0.5 * (upper - lower) + BEYOND
        self._least_torque = -torque
        self._bus: Any = None
        self._can: Any = None
        self._state: JointState | None = None
        self._setpoint: np.ndarray | None = None
        self._frames: dict[int, bytes] = {}
        self._jumps = 0
        self._error_frames = 0
        self._info_due, self._others, self._refused_since = 0.0, -np.inf, np.inf
        self._said_on: bool | None = None
        self._fault, self._told_off = "", 0
        self._writes = ConfirmedWrites(self._switch_servos)
        self._taken = self._periodic = False

    def torque_limit(self, share: float) -> AllegroLoop:
        """Return a limited loop for the same hand (``LoopDriver.torque_limit``)."""
        return AllegroLoop(replace(self.settings, torque_share=share * self.settings.torque_share))

    def open(self) -> None:
        """See ``DeviceLoop.open``. The hand must report the configured generation and side."""
        self._open_bus()
        self._verify()
        listening = time.monotonic() + LISTENING
        while self._state is None and time.monotonic() < listening:
            self._receive(listening - time.monotonic())
        if self._state is None:
            # No other program has requested positions.
            self._ask_for_positions()
        deadline = time.monotonic() + ANSWER_TIMEOUT
        while self._state is None:
            self._receive(deadline - time.monotonic())
            if time.monotonic() > deadline:
                raise RobotError(f"{self.name} names itself but sends no positions: switch it off and on")

    def take_control(self) -> None:
        """See ``DeviceLoop.take_control``. Torques of an earlier program are switched off. Raises:
        RobotError: another program still controls the hand."""
        if time.monotonic() - self._others < OTHERS:
            raise RobotError(f"{self.name}: another program sends torques to this hand: end that one first")
        if not self._servos_on:
            self._writes.put(SERVOS, False, anew=True)
            while self._writes.missing and not self._writes.work():
                self._receive(CAN_WAIT)
        self._ask_for_positions()
        self._taken = True

    def resume(self, positions: np.ndarray) -> None:
        """See ``DeviceLoop``. The hand has kept its last torques, and now holds at the last goal."""
        self._setpoint = np.clip(positions, self.limits.lower, self.limits.upper)
        self._writes.put(SERVOS, True)
        self._taken = True

    @property
    def _servos_on(self) -> bool:
        """Whether the servos should be on."""
        return bool(self._writes.wanted(SERVOS))

    def _ask_for_positions(self) -> None:
        self._send(codec.PERIODS, codec.encode_periods(self.settings.period_ms))
        self._periodic = True

    def step(self, goal: LoopGoal) -> JointState:
        before = self._state
        assert before is not None
        deadline = time.monotonic() + self.settings.stale_after
        while self._state is before and time.monotonic() < deadline:
            self._receive(deadline - time.monotonic())
        # After a pause of this process, only the newest positions matter.
        while self._receive(0.0) is not None:
            pass
        state = self._state
        assert state is not None
        if goal.mode is LoopMode.IDLE and self._fault:
            # The driver has connected again after a fault: ask whether it persists.
            self._fault = ""
            self._ask_info(ANSWER_TIMEOUT / 4)
        if time.monotonic() >= self._info_due:
            # A missing answer is no fault: firmware of the V5 may ignore the request.
            self._ask_info(0.0)
        if state is before:
            raise RobotError(
                f"{self.name} is silent for {1e3 * self.settings.stale_after:.0f} ms{self._errors_in_words()}"
            )
        if self._taken:
            if self._fault:
                goal = replace(goal, mode=LoopMode.POWER_OFF)
            self._send_torques(self._torques(goal, state, state.received - before.received))
            self._writes.work()
        if time.monotonic() - self._refused_since > self.settings.stale_after:
            raise RobotError(f"{self.name}: the CAN bus takes no frames: check cable and power")
        if self._fault:
            return replace(state, status=DeviceStatus.FAULT, message=self._fault)
        return state

    def recover(self) -> None:
        """See ``DeviceLoop``. Opens the bus again, requests positions, and keeps the setpoint."""
        with contextlib.suppress(Exception):
            self._bus.shutdown()
        self._open_bus()
        self._state, self._jumps, self._refused_since = None, 0, np.inf
        self._frames.clear()
        self._ask_for_positions()
        deadline = time.monotonic() + self.settings.stale_after
        while self._state is None:
            self._receive(deadline - time.monotonic())
            if time.monotonic() > deadline:
                raise RobotError(f"{self.name} is silent")
        if self._servos_on:
            self._writes.put(SERVOS, True, anew=True)

    def halt(self) -> bool:
        """See ``DeviceLoop.halt``. Switches torques and servos off."""
        try:
            self._writes.put(SERVOS, False, anew=True)
            self._said_on = None
            self._send_torques(np.zeros(16))
            off = self._switch_servos(SERVOS, False)
            deadline = time.monotonic() + self.settings.stale_after
            while not off and time.monotonic() < deadline:
                if self._receive(deadline - time.monotonic()) is not None:
                    off = self._said_on is False
            self._told_off += self._state is not None and time.monotonic() - self._state.received < 0.1
            return off or self._told_off >= SURE
        except Exception:
            with contextlib.suppress(Exception):
                self._bus.shutdown()
                self._open_bus()
            return False

    def close(self) -> None:
        if self._bus is not None:
            if self._periodic:
                with contextlib.suppress(Exception):
                    self._send(codec.PERIODS, codec.encode_periods(0))
            with contextlib.suppress(Exception):
                self._bus.shutdown()
            self._bus = None

    def _switch_servos(self, name: str, on: bool) -> bool:
        """Switch all servos on or off; return whether the hand has confirmed it."""
        if self._said_on is on:
            return True
        self._send(codec.SERVOS_ON if on else codec.SERVOS_OFF)
        self._ask_info(0.0)
        return False

    def _ask_info(self, wait: float) -> None:
        """Request temperature and faults. wait: longest wait for the answer [s]."""
        now = time.monotonic()
        self._info_due, self._said_on = now + INFO_INTERVAL, None
        self._send(codec.INFO, request=True)
        while wait and self._said_on is None and time.monotonic() < now + wait:
            self._receive(now + wait - time.monotonic())

    def _open_bus(self) -> None:
        self._can = import_client("can", "allegro", "an Allegro Hand")
        s = self.settings
        self._bus = codec.open_can_bus(s.interface, s.channel, s.bitrate)

    def _torques(self, goal: LoopGoal, state: JointState, elapsed: float) -> np.ndarray:
        step = min(elapsed, 0.02)
        self._setpoint = next_setpoint(self._setpoint, goal, state.positions, self.limits, step)
        if self._setpoint is None:
            if goal.mode is LoopMode.POWER_OFF:
                self._writes.put(SERVOS, False)
            return np.zeros(16)
        self._writes.put(SERVOS, True)
        spring = self.settings.kp * (self._setpoint - state.positions)
        torques = spring - self.settings.kd * state.velocities + goal.feedforward
        return np.minimum(np.maximum(torques, self._least_torque), self.limits.torque)

    def _send_torques(self, torques: np.ndarray) -> None:
        for finger, data in enumerate(codec.encode_torques(self._units, torques)):
            self._send(codec.TORQUE + finger, data)

    def _send(self, code: int, data: bytes = b"", request: bool = False) -> None:
        message = self._can.Message(
            arbitration_id=codec.identifier(code, self.settings.device),
            data=data,
            is_extended_id=False,
            is_remote_frame=request,
        )
        try:
            self._bus.send(message, timeout=CAN_WAIT)
        except (self._can.CanError, OSError):
            # The queue may be full for a moment (ENOBUFS); ``step`` raises if it stays full.
            self._refused_since = min(self._refused_since, time.monotonic())
        else:
            self._refused_since = np.inf

    def _receive(self, timeout: float) -> Any:
        """Receive one frame; positions of all four fingers make a state."""
        try:
            message = self._bus.recv(max(timeout, 0.0))
        except (self._can.CanError, OSError) as error:
            raise RobotError(f"{self.name}: the CAN bus failed: {error}") from error
        if message is None:
            return None
        if message.is_error_frame:
            # Its identifier consists of error bits, and may look like that of positions.
            self._take_error(message.arbitration_id)
            return None
        if message.arbitration_id & 3 != self.settings.device or message.is_remote_frame:
            return None
        code = codec.code_of(message.arbitration_id)
        finger = code - codec.POSITION
        if 0 <= finger < codec.FINGERS_ON_BUS and message.dlc == 8:
            self._frames[finger] = bytes(message.data)
            if len(self._frames) == codec.FINGERS_ON_BUS:
                self._take_positions(message.timestamp)
        elif 0 <= code - codec.TORQUE < codec.FINGERS_ON_BUS:
            # Own frames are not received.
            self._others = time.monotonic()
        elif code == codec.INFO and message.dlc >= 7:
            self._take_info(codec.decode_info(bytes(message.data)))
        return message

    def _take_positions(self, stamp: float) -> None:
        """Make a state from one frame per finger; implausible frames are dropped, to wait for the next."""
        before = self._state
        joints = codec.decode_positions(self._units, [self._frames[f] for f in range(codec.FINGERS_ON_BUS)])
        velocities = np.zeros(16)
        if before is not None:
            elapsed = stamp - before.device_time
            move = joints - before.positions
            jumps = np.abs(move) > LARGEST_JUMP + LARGEST_SPEED * max(elapsed, 0.0)
            # This check does not depend on the time between readings.
            jumps |= np.abs(joints - self._middle) > self._believed
            if jumps.any():
                self._drop(jumps)
                return
            elapsed = max(elapsed, 1e-4)
            # (1 - s) v + s move / elapsed, with s = elapsed / (elapsed + filter)
            window = elapsed + self.settings.velocity_filter
            velocities = (self.settings.velocity_filter / window) * before.velocities + move / window
        self._frames.clear()
        self._jumps = 0
        self._state = JointState(
            joints, velocities, None, stamp, time.monotonic(), DeviceStatus.READY, self._errors_in_words()
        )

    def _take_error(self, classes: int) -> None:
        """Handle an error frame of the adapter. classes: bits of its identifier."""
        self._error_frames += 1
        if classes & codec.BUS_OFF:
            raise RobotError(
                f"{self.name}: the CAN bus is off{self._errors_in_words()}; check cable, termination and "
                "bit rate"
            )

    def _errors_in_words(self) -> str:
        return f" ({self._error_frames} error frames on the bus)" if self._error_frames else ""

    def _drop(self, jumps: np.ndarray) -> None:
        """Drop the frames of fingers with implausible joints. jumps: shape [16] bool."""
        bad = np.flatnonzero(jumps.reshape(codec.FINGERS_ON_BUS, -1).any(axis=1)).tolist()
        self._jumps += len(bad)
        if self._jumps >= JUMPS:
            raise RobotError(f"{self.name}: positions jump; check the encoders and the generation")
        for finger in bad:
            del self._frames[finger]

    def _take_info(self, info: codec.AllegroInfo) -> None:
        self._said_on = info.servos_on
        if self._taken and self._servos_on != info.servos_on:
            # The hand missed a frame, or was switched off and on.
            self._writes.put(SERVOS, self._servos_on, anew=True)
        self._fault = ""
        if info.overheated:
            self._fault = f"{self.name} is too hot ({info.temperature} °C): let it cool down"
        elif info.communication_fault:
            self._fault = (
                f"{self.name} has an internal communication fault ({info.temperature} °C): "
                "switch it off and on"
            )

    def _verify(self) -> None:
        answers: dict[int, bytes] = {}
        deadline = time.monotonic() + ANSWER_TIMEOUT
        asked = -np.inf
        while time.monotonic() < deadline and not {codec.INFO, codec.SERIAL} <= set(answers):
            if time.monotonic() - asked > ANSWER_TIMEOUT / 4:
                self._send(codec.INFO, request=True)
                self._send(codec.SERIAL, request=True)
                asked = time.monotonic()
            message = self._receive(0.02)
            if message is not None:
                answers[codec.code_of(message.arbitration_id)] = bytes(message.data)
        self._state, self._jumps = None, 0
        self._frames.clear()
        if codec.INFO not in answers or (self.settings.generation == 5 and codec.SERIAL not in answers):
            raise RobotError(f"{self.name}: no hand answers; check power, cable, bit rate and device number")
        if self._fault:
            raise RobotError(self._fault)
        info = codec.decode_info(answers[codec.INFO])
        generation = info.hardware >> 8
        if generation != self.settings.generation:
            raise RobotError(
                f"{self.name}: the hand says that it is a V{generation}, whose units differ; set "
                f"generation = {generation}"
            )
        serial = answers.get(codec.SERIAL, b"").decode(errors="replace")
        left = info.left if generation == 4 else serial[3:4] != "R"
        if left != (self.settings.side == "left"):
            raise RobotError(f"{self.name}: the hand says that it is a {'left' if left else 'right'} one")
        if generation == 5 and serial[2:3] != "A":
            self._units = codec.ALLEGRO_V5_GEARED
