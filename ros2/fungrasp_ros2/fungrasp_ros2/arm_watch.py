"""What ur_robot_driver says of an arm on several topics, as one state of a driver. Needs no ROS.

| topic of ur_robot_driver | watched for |
| --- | --- |
| joint_states | age, positions |
| io_and_status_controller/safety_mode | protective, safeguard and emergency stops, faults |
| io_and_status_controller/robot_program_running | the program that follows commands runs |
| speed_scaling_state_broadcaster/speed_scaling | 100: below, setpoints are left out |
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fungrasp.robots.device import DeviceStatus, JointState

NORMAL, REDUCED, PROTECTIVE_STOP = 1, 2, 3
STOPS = {
    3: (DeviceStatus.PROTECTIVE_STOP, "protective stop: acknowledge it on the pendant"),
    4: (DeviceStatus.FAULT, "recovery mode: move the arm back from the pendant"),
    5: (DeviceStatus.FAULT, "safeguard stop: leave the cell, then reset it"),
    6: (DeviceStatus.EMERGENCY_STOP, "emergency stop of the system: release it, then connect again"),
    7: (DeviceStatus.EMERGENCY_STOP, "emergency stop: release it, then connect again"),
    8: (DeviceStatus.FAULT, "safety violation: look at the pendant"),
    9: (DeviceStatus.FAULT, "safety fault: look at the pendant"),
    10: (DeviceStatus.FAULT, "joint identification: look at the pendant"),
    12: (DeviceStatus.FAULT, "safeguard stop of automatic mode: reset it"),
    13: (DeviceStatus.FAULT, "the enabling switch is released"),
}
"""Modes of ur_dashboard_msgs/SafetyMode that end motion; others than these and the normal two are faults."""
FULL_SPEED = 99.0
"""Percent: below, the controller takes longer for a setpoint than we for the next one."""


@dataclass
class ArmWatch:
    """The newest of every topic."""

    joints: int
    """How many the arm has."""
    stale_after: float
    """Joint states older than this are none [s]."""
    watched: frozenset[str] = frozenset({"safety_mode", "robot_program_running", "speed_scaling"})
    """Topics without which the arm is not ready."""
    positions: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Measured [rad], shape [U]."""
    velocities: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Measured [rad/s], shape [U]."""
    device_time: float = 0.0
    """Stamp of the joint states [s]."""
    received: float = -np.inf
    """Host time at which the stamp advanced [s]."""
    fault: str = ""
    """What was wrong with the last message of joint states; "" for nothing."""
    safety_mode: int | None = None
    """Of ur_dashboard_msgs/SafetyMode; None before the first."""
    program_running: bool | None = None
    """None before the first message."""
    speed_scaling: float | None = None
    """Percent; None before the first message."""

    def hear_joints(self, positions: np.ndarray, velocities: np.ndarray, stamp: float, now: float) -> None:
        """Joint states came; a stamp that does not advance does not make them younger.

        Args:
            positions: [rad], shape [U].
            velocities: [rad/s], shape [U]; NaN where they are not said.
            stamp: of the message [s].
            now: host time [s].
        """
        if stamp == self.device_time and len(self.positions):
            return
        if not np.isfinite(velocities).all():
            elapsed = stamp - self.device_time
            known = len(self.positions) and elapsed > 0
            velocities = (positions - self.positions) / elapsed if known else np.zeros(self.joints)
        self.positions, self.velocities = positions, velocities
        self.device_time, self.received, self.fault = stamp, now, ""

    def state(self, now: float, taken: bool) -> JointState:
        """The arm as a driver says it.

        Args:
            now: host time [s].
            taken: whether it is led by us: only then are program and speed our matter.
        """
        status, message = self._status(now, taken)
        positions = self.positions if len(self.positions) else np.zeros(self.joints)
        velocities = self.velocities if len(self.velocities) else np.zeros(self.joints)
        received = self.received if np.isfinite(self.received) else now
        return JointState(positions, velocities, None, self.device_time, received, status, message)

    def why_not(self) -> str:
        """What speaks against leading the arm now, as a phrase; "" for nothing."""
        heard = {
            "safety_mode": self.safety_mode,
            "robot_program_running": self.program_running,
            "speed_scaling": self.speed_scaling,
        }
        for name in sorted(self.watched):
            if heard[name] is None:
                return f"nothing has come on the topic of {name}: is ur_robot_driver running?"
        if "robot_program_running" in self.watched and not self.program_running:
            return "the program on the controller does not run: start External Control on the pendant"
        if "speed_scaling" in self.watched and (self.speed_scaling or 0.0) < FULL_SPEED:
            return f"the controller runs at {self.speed_scaling:.0f} % of its speed: set the slider to 100 %"
        return ""

    def _status(self, now: float, taken: bool) -> tuple[DeviceStatus, str]:
        if self.fault:
            return DeviceStatus.DISCONNECTED, self.fault
        age = now - self.received
        if age > self.stale_after:
            words = (
                f"no new joint states for {1e3 * age:.0f} ms" if np.isfinite(age) else "no joint states yet"
            )
            return DeviceStatus.DISCONNECTED, words
        mode = self.safety_mode
        if "safety_mode" in self.watched and mode not in (None, NORMAL, REDUCED):
            return STOPS.get(int(mode), (DeviceStatus.FAULT, f"safety mode {mode}: look at the pendant"))
        why = self.why_not() if taken else ""
        return (DeviceStatus.FAULT, why) if why else (DeviceStatus.READY, "")
