"""Driver of UR5 and UR5e over RTDE, with the client library ur_rtde.

The arm gets setpoints at the controller's rate, 500 Hz (CB3: 125 Hz), within our limits of speed,
acceleration and jerk (ruckig), as ``servoj`` has none. The controller stops the program if it receives
nothing for 0.2 s. Return values do not show success: after a controller has died, ur_rtde's calls still
return true, and positions keep their last values. Only a controller clock that advances does.
"""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.formats.checks import one_line
from fungrasp.geometry.poses import compose, invert, quaternion_from_rotation_vector
from fungrasp.robots.control_loop.device_loop import DeviceLoop, LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError, import_client

VARIABLES = ["timestamp", "actual_q", "actual_qd", "runtime_state", "safety_status_bits"]
VARIABLES += ["robot_status_bits", "speed_scaling", "target_speed_fraction", "actual_TCP_pose"]
PAYLOAD_TOLERANCE, PAYLOAD_CENTER_TOLERANCE = 0.1, 0.01
"""Tolerances of the payload's mass [kg] and of its center along each axis [m]."""
PLAYING = 2
RTDE_PORT = 30004
IN_USE = (
    "another program, or a fieldbus, controls this arm: its input registers are in use; end that one first"
)
STOP_TIMEOUT = 2.0
"""Longest wait for a program to stop, and for a connection [s]."""
EMERGENCY_BITS = 1 << 5 | 1 << 6 | 1 << 7
PROTECTIVE_BIT = 1 << 2
SAFEGUARD_BIT = 1 << 4
SAFETY_FAULT_BITS = 1 << 3 | 1 << 8 | 1 << 9 | 1 << 10
JOINTS = 6
STATE_RATE = 125.0
"""Rate of states from the controller [Hz]. Setpoints go out at the controller's own rate, four times as high
on an e-Series. The client library takes as long to receive a state as we need for a setpoint."""
BASE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Pose of the controller's frame Base in the models' ``base_link``: half a turn about z."""
FLANGE_TOLERANCE = 0.005
"""Distance between the flanges of model and controller beyond which the arm is refused [m]: calibration
changes a millimeter or two; a UR5 and a UR5e differ by 60 to 90 mm."""
FULL_SPEED = 0.99
"""Share of its speed below which the controller is too slow: ``servoj`` takes longer than our period,
setpoints are skipped, and the arm lags, or catches up when the slider is raised."""
LARGEST_JUMP = 0.1
"""Change of a joint, beyond that at ``LARGEST_SPEED``, which makes a reading implausible [rad]."""
LARGEST_SPEED = 6.3
"""Twice the largest speed of a UR's joints [rad/s]."""


@dataclass(frozen=True)
class URSettings:
    """Connection of a UR arm, and limits of its motion."""

    address: str = "192.168.0.10"
    """Address of the controller."""
    model: str = "UR5"
    """Model as the controller reports it ("UR5" for UR5 and UR5e); any other is refused."""
    arm: str = "ur5e"
    """Model of the arm, "ur5" (CB3), "ur5e" or a file, in a cell ``arm.model``; refused if its flange is not
    where the controller reports it."""
    serial: str = ""
    """Serial number of the arm; any other is refused. Empty: any."""
    velocity: float = 1.0
    """Largest speed of each joint [rad/s]; the default is a third of the arm's own."""
    acceleration: float = 2.5
    """Largest acceleration of each joint [rad/s^2]."""
    jerk: float = 50.0
    """Largest jerk of each joint [rad/s^3]."""
    range: float = 2 * np.pi
    """Limit of each joint to both sides [rad]."""
    lookahead: float = 0.05
    """Lookahead time of servoj [s], 0.03 to 0.2; the arm lags by it."""
    gain: float = 300.0
    """Gain of servoj, 100 to 2000."""
    watchdog: float = 5.0
    """Rate of messages below which the controller stops its program [Hz]."""
    stale_after: float = 0.04
    """Time without an advance of the controller's clock after which the connection is lost [s]."""
    payload: float = -1.0
    """Mass of hand, adapter and cables [kg]; the arm is refused if the pendant has another mass. Negative:
    not compared."""
    payload_center: tuple[float, ...] = ()
    """Center of this mass, flange frame [m]; empty: not compared."""

    def __post_init__(self) -> None:
        if len(self.payload_center) not in (0, 3):
            raise RobotError("payload_center has 3 numbers")
        if not 0.03 <= self.lookahead <= 0.2 or not 100 <= self.gain <= 2000:
            raise RobotError("servoj takes a lookahead of 0.03 to 0.2 s and a gain of 100 to 2000")
        if not 0 < self.velocity <= 3.14 or not 0 < self.acceleration <= 40 or self.jerk <= 0:
            raise RobotError("a UR joint takes up to 3.14 rad/s and 40 rad/s^2, and a jerk above 0")


class URLoop(DeviceLoop):
    """Control loop of a UR arm."""

    def __init__(self, settings: URSettings):
        self.settings = settings
        self.name = f"{settings.model} at {settings.address}"
        self.stale_after = settings.stale_after
        reach = np.full(JOINTS, settings.range)
        speed = np.full(JOINTS, settings.velocity)
        self.limits = JointLimits(-reach, reach, speed, np.full(JOINTS, np.inf))
        self._receive: Any = None
        self._control: Any = None
        self._ruckig: Any = None
        self._path: Any = None
        self._step: Any = None
        self._period = 0.002
        self._due = 0.0
        self._advanced, self._clock = 0.0, -1.0
        self._looked = self._silence = 0.0
        self._last: list[float] | None = None
        self._last_clock = 0.0
        self._lead: Any = None
        self._led: LoopMode | None = None
        self._going: tuple[Any, ...] = ()
        self._target: np.ndarray | None = None
        self._known: JointState | None = None
        self._slowed = self._taken = False
        self._compared = ""

    def open(self) -> None:
        """See ``DeviceLoop.open``. Model, serial number and state of the controller are checked."""
        dashboard = import_client("dashboard_client", "ur", "a UR arm")
        receive = import_client("rtde_receive", "ur", "a UR arm")
        self._ruckig = import_client("ruckig", "ur", "a UR arm")
        with self._errors_as_ours():
            self._check(dashboard.DashboardClient(self.settings.address))
            # Controllers before 3.11 do not report the payload.
            variables = VARIABLES + ["payload", "payload_cog"] * (self.settings.payload >= 0)
            with _patient_threads():
                self._receive = receive.RTDEReceiveInterface(self.settings.address, STATE_RATE, variables)
        if not self._receive.getActualQ():
            raise RobotError(f"{self.name}: the controller sends no joint positions; restart it")
        self._path = self._ruckig.Ruckig(JOINTS, self._period)
        # Kept between steps, as it holds the path.
        self._step = self._ruckig.OutputParameter(JOINTS)
        self._going = (self._ruckig.Result.Working, self._ruckig.Result.Finished)
        self._advanced = self._due = time.monotonic()

    def take_control(self) -> None:
        """See ``DeviceLoop.take_control``. The client library's program replaces any other one. Speed,
        kinematics and payload are checked."""
        slowed = self._slowed_in_words()
        if slowed:
            raise RobotError(f"{self.name}: {slowed}")
        if self._control is None:
            control = import_client("rtde_control", "ur", "a UR arm")
            self._end_other_program()
            # Before the program runs, as compiling the model takes longer than its watchdog allows.
            flange = arm_flange(self.settings.arm)
            with self._errors_as_ours(), _patient_threads():
                self._control = control.RTDEControlInterface(self.settings.address, STATE_RATE)
            self._set_watchdog()
            self._compared = f"{self._check_kinematics(flange)}; {self._check_payload()}"
        elif not self._control.isProgramRunning():
            self._restart()
        self._taken = True
        self._advanced = self._due = time.monotonic()

    def _end_other_program(self) -> None:
        """End a program on the controller, unless a client commands it. The client library only stops its own
        program, and would wait forever for another one."""
        if self._receive.getRuntimeState() != PLAYING:
            return
        if self._commanded():
            raise RobotError(f"{self.name}: {IN_USE}")
        dashboard = import_client("dashboard_client", "ur", "a UR arm").DashboardClient(self.settings.address)
        with self._errors_as_ours():
            dashboard.connect(2000)
            try:
                dashboard.stop()
            finally:
                dashboard.disconnect()
        deadline = time.monotonic() + STOP_TIMEOUT
        while self._receive.getRuntimeState() == PLAYING:
            if time.monotonic() > deadline:
                raise RobotError(f"{self.name}: the program that runs does not stop: end it on the pendant")
            time.sleep(0.01)

    def _commanded(self) -> bool:
        """Return whether a client uses the input registers by which a program is commanded."""
        try:
            with socket.create_connection((self.settings.address, RTDE_PORT), STOP_TIMEOUT) as connection:
                # Packages: length with header, type, data. V: version of the protocol, I: inputs.
                for kind, data in ((b"V", b"\0\2"), (b"I", b"input_int_register_0")):
                    connection.sendall(struct.pack(">Hc", 3 + len(data), kind) + data)
                stream = b""
                while data := connection.recv(4096):
                    stream += data
                    while len(stream) >= 3 and len(stream) >= (size := max(3, int.from_bytes(stream[:2]))):
                        if stream[2:3] == b"I":
                            return b"IN_USE" in stream[3:size]
                        stream = stream[size:]
        except OSError as error:
            raise RobotError(f"{self.name}: {one_line(error)}; check the cable to the controller") from error
        raise RobotError(f"{self.name}: the controller says nothing of its registers; restart it")

    @contextlib.contextmanager
    def _errors_as_ours(self) -> Iterator[None]:
        """Raise connection errors as ``RobotError``, in one line."""
        try:
            yield
        except RuntimeError as error:
            if "already in use" in str(error):
                raise RobotError(f"{self.name}: {IN_USE}") from error
            raise RobotError(
                f"{self.name}: {one_line(error)}; check address, power and remote control"
            ) from error
        except ValueError as error:
            raise RobotError(f"{self.name}: {one_line(error)}") from error

    def step(self, goal: LoopGoal) -> JointState:
        try:
            return self._follow(goal)
        except RuntimeError as error:
            # ur_rtde may notice a lost connection before the controller's clock shows it.
            raise RobotError(f"{self.name}: {one_line(error)}; check the cable to the controller") from error

    def _follow(self, goal: LoopGoal) -> JointState:
        self._wait()
        now = time.monotonic()
        clock = self._receive.getTimestamp()
        state, stale = self._known, self.settings.stale_after
        # After a pause of this process, states may wait to be received: look twice.
        self._silence += min(now - self._looked, 0.5 * stale)
        self._looked = now
        if clock != self._clock or state is None:
            self._advanced, self._clock, self._silence = now, clock, 0.0
            state = self._known = self._state()
        elif self._silence > stale:
            waited = 1e3 * (now - self._advanced)
            raise RobotError(f"{self.name}: the controller's clock stands still for {waited:.0f} ms")
        if state.status is DeviceStatus.READY or self._slowed:
            # A slowed arm is braked by setpoints, as for HOLD.
            self._move(goal, state)
        elif state.status is DeviceStatus.FAULT and goal.mode is LoopMode.IDLE:
            # The driver has connected again after the program stopped: ``take_control`` restarts it.
            self._taken = False
            state = self._known = self._state()
        return state

    def halt(self) -> None:
        """See ``DeviceLoop.halt``. Brake and end the program; without a connection, the controller's watchdog
        does so."""
        if self._control is None or time.monotonic() - self._advanced > self.settings.stale_after:
            return
        with contextlib.suppress(Exception):
            self._control.servoStop(self.settings.acceleration)
            self._control.stopScript()

    def close(self) -> None:
        """See ``DeviceLoop.close``. The connections end with the process, as closing them takes ur_rtde a
        second, or forever if the controller does not answer."""

    def _check(self, dashboard: Any) -> None:
        dashboard.connect(2000)
        try:
            model = dashboard.getRobotModel()
            if model.strip().upper() != self.settings.model.upper():
                raise RobotError(f"{self.name}: the controller says that it is a {model}")
            if self.settings.serial and dashboard.getSerialNumber() != self.settings.serial:
                raise RobotError(
                    f"{self.name}: the controller's serial number is {dashboard.getSerialNumber()}, not "
                    f"{self.settings.serial}"
                )
            self._period = _controller_period(dashboard.polyscopeVersion())
            safety = dashboard.safetystatus().rpartition(":")[2].strip()
            if safety not in ("NORMAL", "REDUCED"):
                raise RobotError(f"{self.name} is in {safety}: find the cause, acknowledge it on the pendant")
            mode = dashboard.robotmode().rpartition(":")[2].strip()
            if mode != "RUNNING":
                raise RobotError(
                    f"{self.name} is in mode {mode}: switch it on and release the brakes on the pendant"
                )
        finally:
            dashboard.disconnect()

    def _check_kinematics(self, model: Callable[[Sequence[float]], np.ndarray]) -> str:
        """Compare the flanges of the model, for which plans are made, and of the controller, in words."""
        tool = compose(BASE, _pose(self._receive.getActualTCPPose()))
        flange = compose(tool, invert(_pose(self._control.getTCPOffset())))
        apart = float(np.linalg.norm(flange[:3] - model(self._receive.getActualQ())))
        if not apart <= FLANGE_TOLERANCE:
            raise RobotError(
                f"{self.name}: by the model '{self.settings.arm}' the flange is {1e3 * apart:.0f} mm from "
                'where the controller says: is the arm of another generation ("ur5" for CB3, "ur5e"), or is '
                "its calibration far from nominal?"
            )
        return f"the model's flange is {1e3 * apart:.1f} mm from the controller's"

    def _check_payload(self) -> str:
        """Compare the payload, in words. With a wrong mass, the controller detects false contacts or none."""
        s = self.settings
        if s.payload < 0:
            return "payload not compared"
        mass, center = self._receive.getPayload(), np.array(self._receive.getPayloadCog())
        wrong = not abs(mass - s.payload) <= PAYLOAD_TOLERANCE
        if s.payload_center:
            wrong |= not np.abs(center - s.payload_center).max() <= PAYLOAD_CENTER_TOLERANCE
        if wrong:
            x, y, z = 1e3 * center
            raise RobotError(
                f"{self.name}: the pendant says a payload of {mass:.2f} kg at ({x:.0f}, {y:.0f}, {z:.0f}) "
                f"mm, the cell {s.payload:g} kg at {[round(1e3 * v) for v in s.payload_center]}: "
                "weigh the hand, and correct the one that is wrong"
            )
        return f"payload {mass:.2f} kg, as the cell says"

    def _set_watchdog(self) -> None:
        if not self._control.setWatchdog(self.settings.watchdog):
            raise RobotError(f"{self.name}: the controller refuses the watchdog; restart its program")

    def _restart(self) -> None:
        self._lead = None
        if not self._control.reuploadScript():
            raise RobotError(
                f"{self.name}: the program can't be started; check remote control on the pendant"
            )
        deadline = time.monotonic() + 2.0
        while not self._control.isProgramRunning():
            if time.monotonic() > deadline:
                raise RobotError(f"{self.name}: the program does not start; look at the pendant")
            time.sleep(0.01)
        self._set_watchdog()

    def _wait(self) -> None:
        self._due += self._period
        rest = self._due - time.monotonic()
        if rest > 0:
            time.sleep(rest)
        else:
            self._due = time.monotonic()

    def _state(self) -> JointState:
        positions, velocities = self._receive.getActualQ(), self._receive.getActualQd()
        safety = self._receive.getSafetyStatusBits()
        running = self._receive.getRuntimeState() == PLAYING
        largest = LARGEST_JUMP + LARGEST_SPEED * max(self._clock - self._last_clock, 0.0)
        last = positions if self._last is None else self._last
        # NumPy would take longer for six numbers. NaN fails the comparison.
        if not (
            len(positions) == len(velocities) == JOINTS
            and all(abs(a - b) < largest for a, b in zip(positions, last, strict=True))
        ):
            raise RobotError(f"{self.name}: implausible positions; check the cable to the controller")
        self._last, self._last_clock = positions, self._clock
        status, message = DeviceStatus.READY, self._compared if self._taken else ""
        if safety & EMERGENCY_BITS:
            status, message = DeviceStatus.EMERGENCY_STOP, "emergency stop: release it, then connect again"
        elif safety & PROTECTIVE_BIT:
            status, message = DeviceStatus.PROTECTIVE_STOP, "protective stop: acknowledge it on the pendant"
        elif safety & SAFEGUARD_BIT:
            # The controller resumes when the guard is closed; this driver does not.
            status, message = DeviceStatus.FAULT, "safeguard stop: close the guard, then connect again"
        elif safety & SAFETY_FAULT_BITS:
            status, message = DeviceStatus.FAULT, f"safety status {safety:#x}: look at the pendant"
        elif self._taken and not running:
            status, message = DeviceStatus.FAULT, "the controller has stopped the program: connect again"
        self._slowed = False
        if self._taken and status is DeviceStatus.READY and (slowed := self._slowed_in_words()):
            status, message, self._slowed = DeviceStatus.FAULT, slowed, True
        return JointState(
            np.array(positions), np.array(velocities), None, self._clock, self._advanced, status, message
        )

    def _slowed_in_words(self) -> str:
        """Return what slows the controller down, as a phrase; "" at full speed."""
        combined = self._receive.getSpeedScalingCombined()
        if combined >= FULL_SPEED:
            return ""
        return (
            f"the controller runs at {100 * combined:.0f} % of its speed (slider at "
            f"{100 * self._receive.getTargetSpeedFraction():.0f} %): set the slider to 100 %; slow motion is "
            "for the cell's limits"
        )

    def _move(self, goal: LoopGoal, state: JointState) -> None:
        if not self._taken:
            return
        resting = goal.mode in (LoopMode.IDLE, LoopMode.STAND_BY)
        if resting or (goal.mode is LoopMode.POWER_OFF and self._lead is None):
            self._control.kickWatchdog()
            return
        if self._lead is None:
            self._lead = self._new_lead(state.positions)
        lead, step = self._lead, self._step
        following = goal.mode is LoopMode.FOLLOW
        if goal.mode is not self._led:
            self._led, interface = goal.mode, self._ruckig.ControlInterface
            lead.control_interface = interface.Position if following else interface.Velocity
        if following and goal.positions is not self._target:
            self._target = goal.positions
            lead.target_position = goal.positions.tolist()
        result = self._path.update(lead, step)
        if result not in self._going:
            raise RobotError(f"{self.name}: no path to the goal within the limits ({result})")
        s, new = self.settings, step.new_position
        largest = 1.5 * s.velocity * self._period
        if not all(abs(a - b) <= largest for a, b in zip(new, lead.current_position, strict=True)):
            raise RobotError(f"{self.name}: a setpoint that jumped was not sent: this is a bug in fungrasp")
        step.pass_to_input(lead)
        self._control.servoJ(new, 0.0, 0.0, self._period, s.lookahead, s.gain)

    def _new_lead(self, positions: np.ndarray) -> Any:
        self._target = self._led = None
        s, lead = self.settings, self._ruckig.InputParameter(JOINTS)
        lead.current_position = positions.tolist()
        lead.current_velocity = lead.current_acceleration = [0.0] * JOINTS
        lead.target_velocity = lead.target_acceleration = [0.0] * JOINTS
        lead.max_velocity = [s.velocity] * JOINTS
        lead.max_acceleration = [s.acceleration] * JOINTS
        lead.max_jerk = [s.jerk] * JOINTS
        # A common duration would slow all joints to the slowest.
        lead.synchronization = self._ruckig.Synchronization.No
        return lead


def arm_flange(arm: str) -> Callable[[Sequence[float]], np.ndarray]:
    """Return a function from joints [rad], shape [6], to the position of the model's flange, frame
    ``base_link`` [m], shape [3]. arm: name or file of the model."""
    # Imported here, as reading an arm needs no physics engine.
    import mujoco

    from fungrasp.hands.arm import FLANGE_SITE, arm_spec

    model = arm_spec(arm).compile()
    data, site = mujoco.MjData(model), model.site(FLANGE_SITE).id

    def flange(joints: Sequence[float]) -> np.ndarray:
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        return data.site_xpos[site].copy()

    return flange


@contextlib.contextmanager
def _patient_threads() -> Iterator[None]:
    """Context in which new threads may oversleep by 2 ms, a setpoint period. Two threads of the client
    library poll every 0.1 ms, which takes as much of a processor as all our steps. Linux only (prctl(2),
    PR_SET_TIMERSLACK)."""
    file = Path("/proc/thread-self/timerslack_ns")
    with contextlib.suppress(OSError):
        file.write_text("2000000")
    yield
    with contextlib.suppress(OSError):
        file.write_text("50000")


def _controller_period(version: str) -> float:
    """Return the period of an e-Series (software 5 and later) or CB3 controller [s]. version: such as
    "URSoftware 5.11.0.1 (...)"."""
    found = re.search(r"(\d+)\.\d+", version)
    return 0.002 if found is None or int(found[1]) >= 5 else 0.008


def _pose(vector: list[float]) -> np.ndarray:
    """Convert the controller's position and rotation vector to a pose, shape [7]."""
    return np.concatenate([vector[:3], quaternion_from_rotation_vector(np.array(vector[3:]))])
