"""The safety filter, which checks every setpoint before it is sent.

It protects against software errors. It is not a safety function as defined by standards: that is the robot's
own controller, with its limits set, and an emergency stop within reach.

docs/deploy.md, "Safety filter", lists the checks and reactions. "Hold": the arm brakes and keeps its
position, the hand keeps its targets. "Open": the arm holds and the hand opens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from fungrasp.geometry.poses import relative, rotation_vector
from fungrasp.robots.cell import RobotCell, Workspace
from fungrasp.robots.device import (
    DeviceStatus,
    JointLimits,
    JointState,
    RobotCommand,
    RobotState,
    SafetyStop,
    StopKind,
    TrackedPose,
)
from fungrasp.robots.kinematics.arm_model import Clearance, outside
from fungrasp.task import Action
from fungrasp.task.setpoints import SETPOINT_PERIOD

TOLERANCE = 1.02
"""Factor by which commanded speeds may exceed their limits, for rounding."""

UNPUNCTUAL = 0.005
"""Time by which a setpoint may come too early, for errors of clocks and waiting [s]."""

AHEAD = 0.02
"""Time in the future beyond which a tracked pose was stamped by another clock [s]."""

LONGEST_STEP = 0.1
"""Longest time between two goals of a single device that counts for its speed limit [s]."""


def check_posture(palm: np.ndarray, clearance: Clearance, box: Workspace) -> str:
    """Return what is wrong with a posture, as a phrase; "" if nothing. palm: world frame, shape [7]."""
    return outside(palm, box) or clearance.fault(box)


def check_pose(tracked: TrackedPose | None, reference: np.ndarray, time: float, cell: RobotCell) -> str:
    """Return what is wrong with a tracked pose before the fingers close, as a phrase; "" if nothing.

    Args:
        tracked: the latest pose; None if there is none.
        reference: expected pose of the object, world frame, shape [7].
        time: time on the robot's clock [s].
    """
    if tracked is None:
        return "the tracker has not seen the object"
    if not np.isfinite([*tracked.pose_world_object, tracked.captured, tracked.score]).all():
        return "the tracked pose is not finite"
    age = time - tracked.captured
    if age < -AHEAD:
        return f"the tracked pose is {-1e3 * age:.0f} ms ahead of the robot's clock"
    if age > cell.watchdog.pose_stale:
        return f"the tracked pose is {1e3 * age:.0f} ms old"
    if tracked.score < cell.watchdog.pose_score:
        return f"the tracker's confidence is {tracked.score:.2f}"
    apart = relative(reference, tracked.pose_world_object)
    jump, turn = float(np.linalg.norm(apart[:3])), float(np.linalg.norm(rotation_vector(apart[3:])))
    if jump > cell.watchdog.pose_jump:
        return f"the tracked object has jumped by {100 * jump:.1f} cm"
    if turn > cell.watchdog.pose_turn:
        return f"the tracked object has turned by {np.rad2deg(turn):.0f} degrees"
    return ""


def action_problem(action: Action, palm: np.ndarray, cell: RobotCell) -> str:
    """Return what is wrong with an action of a policy, as a phrase; "" if nothing. ``Robot.send_action``
    refuses values that are not finite. palm: measured palm pose, world frame, shape [7]."""
    far = float(np.linalg.norm(action.palm_goal_world[0, :3] - palm[:3]))
    if far > cell.limits.goal_distance:
        return f"the palm would move by {far:.2f} m at once"
    return ""


class SafetyGuard:
    """Checks every command of a robot before it is sent, or with ``joints`` those of a single device."""

    def __init__(
        self,
        cell: RobotCell,
        limits: Mapping[str, JointLimits],
        clearance: Callable[[np.ndarray, np.ndarray], Clearance] = lambda arm, fingers: Clearance(),
        period: float = SETPOINT_PERIOD,
        palm: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        """
        Args:
            limits: limits of the drivers of "arm" and "hand", or of a single one.
            clearance: returns the clearance at joints of arm and hand [rad], shapes [A] and [U].
            period: time between setpoints [s].
            palm: returns the palm pose at joints of the arm; if None, the pose in the command is used.
        """
        self._cell, self._limits, self._clearance, self._palm = cell, limits, clearance, palm
        self._period = period
        self.longest_silence = dict.fromkeys(limits, 0.0)
        """Longest time between setpoints without a new time stamp of the device, by device [s]."""
        self.reset()

    def reset(self) -> None:
        """Forget the previous setpoints, as the robot stands still."""
        self._previous: RobotCommand | None = None
        self._before: RobotCommand | None = None
        self._stamps: dict[str, tuple[float, float]] = {}
        self._last: tuple[np.ndarray, float] | None = None
        self._when, self._saved = -np.inf, 0.0
        self.lost = 0.0
        """Delay of the last setpoint that is not made up for [s]: later setpoints shift by it."""

    def __call__(self, state: RobotState, command: RobotCommand) -> RobotCommand:
        """Return the command, clipped to the limits of position and speed. Raises: SafetyStop: it must not be
        sent."""
        for values in (command.arm, command.hand, command.feedforward, command.palm):
            if not np.isfinite(values).all():
                raise SafetyStop("a setpoint is not finite")
        for part, joints in (("arm", state.arm), ("hand", state.hand)):
            silence = self._silence(part, joints, state.time)
            if joints.status is not DeviceStatus.READY:
                said = f": {joints.message}" if joints.message else ""
                raise SafetyStop(f"the {part} does not follow ({joints.status}{said})")
            self._check_reading(part, joints, silence)
        self._keep_time(state.time)
        allowed = self._within_limits(command)
        lead = max(float(np.abs(q - state.arm.positions).max()) for q in (command.arm, allowed.arm))
        if lead > self._cell.limits.setpoint_lead:
            raise SafetyStop("the arm's setpoint is far from where the arm is")
        # Targets of squeezing fingers lie inside the object, so the measured fingers are checked.
        gap = self._clearance(allowed.arm, state.hand.positions)
        problem = check_posture(allowed.palm, gap, self._cell.workspace) or self._too_fast(allowed)
        if problem:
            raise SafetyStop(problem)
        self._before, self._previous = self._previous, allowed
        return allowed

    def _check_reading(self, part: str, state: JointState, silence: float) -> None:
        """Check the readings of a device. silence: time since its last new time stamp [s]. Raises:
        SafetyStop: a value is not finite or beyond its limit, or the device is silent."""
        # Comparisons with limits do not notice NaN.
        values = state.positions, state.velocities, state.device_time, state.torques
        if not all(np.isfinite(v).all() for v in values if v is not None):
            raise SafetyStop(f"a reading of the {part} is not finite")
        dog = self._cell.watchdog
        if silence > (dog.arm_silence if part == "arm" else dog.hand_silence):
            raise SafetyStop(f"the {part} has been silent for {1e3 * silence:.0f} ms")
        measured = np.zeros(0) if part == "arm" or state.torques is None else state.torques
        if np.abs(measured).max(initial=0.0) > self._cell.limits.hand_torque:
            raise SafetyStop("the torque of a hand joint is beyond its limit", StopKind.OPEN)

    def _within_speed(self, part: str, goal: np.ndarray, last: np.ndarray, elapsed: float) -> np.ndarray:
        """Return the goal, clipped to what the joints can reach from the last one [rad], shape [U]. elapsed:
        time since the last one [s]."""
        own = self._cell.limits.arm_speed if part == "arm" else self._cell.limits.hand_speed
        reach = TOLERANCE * np.minimum(self._limits[part].velocity, own) * elapsed
        return np.clip(goal, last - reach, last + reach)

    def _within_limits(self, command: RobotCommand) -> RobotCommand:
        """Return the setpoint within the limits of joint positions and speeds, with its palm pose."""
        parts = {}
        for part, limits in self._limits.items():
            given = getattr(command, part)
            allowed = np.clip(given, limits.lower, limits.upper)
            if self._previous is not None:
                last = getattr(self._previous, part)
                allowed = self._within_speed(part, allowed, last, self._period)
            if np.abs(allowed - given).max(initial=0.0) > 1e-9:
                parts[part] = allowed
        if "arm" in parts and self._palm is not None:
            # Check the pose that will be sent.
            parts["palm"] = self._palm(parts["arm"])
        return replace(command, **parts)

    def _too_fast(self, command: RobotCommand) -> str:
        """Return which part of a setpoint is too fast, as a phrase; these parts are not clipped."""
        limits, period = self._cell.limits, self._period
        if self._previous is None:
            return ""
        step = float(np.linalg.norm(command.palm[:3] - self._previous.palm[:3]))
        if step > TOLERANCE * limits.palm_speed * period:
            return f"the palm would move at {step / period:.2f} m/s"
        if self._before is not None:
            change = float(np.abs(command.arm - 2.0 * self._previous.arm + self._before.arm).max())
            if change > TOLERANCE * limits.setpoint_acceleration * period**2:
                return f"an arm joint would accelerate by {change / period**2:.1f} rad/s^2"
        return ""

    def _keep_time(self, now: float) -> None:
        """Refuse bursts of setpoints, in which limits per step would not limit the speed. now: time on the
        robot's clock [s]. Raises: SafetyStop: setpoints come too fast."""
        saved = self._saved + now - self._when - self._period
        self._when = now
        # A delay beyond ``late_tick`` is not made up for.
        self.lost = saved if saved > self._cell.watchdog.late_tick else 0.0
        self._saved = 0.0 if self.lost else saved
        if self._saved < -UNPUNCTUAL:
            raise SafetyStop(f"setpoints come in less than {1e3 * self._period:.0f} ms")

    def joints(self, part: str, state: JointState, goal: np.ndarray, now: float) -> np.ndarray:
        """Return the goal of a single device, clipped to the limits [rad], shape [U]. Goals may come at any
        time.

        Args:
            part: "arm" or "hand".
            goal: finite values [rad], shape [U].
            now: time on the robot's clock [s].

        Raises:
            SafetyStop: the goal must not be sent.
        """
        silence = self._silence(part, state, now)
        last, when = self._last or (state.positions, -np.inf)
        dog = self._cell.watchdog
        # Between goals nothing is read, so an old time stamp does not mean silence.
        recent = now - when < (dog.arm_silence if part == "arm" else dog.hand_silence)
        self._check_reading(part, state, silence if recent else 0.0)
        limits, elapsed = self._limits[part], min(now - when, LONGEST_STEP)
        goal = np.clip(goal, limits.lower, limits.upper)
        allowed = self._within_speed(part, goal, last, elapsed)
        self._last = allowed, now
        return allowed

    def _silence(self, part: str, state: JointState, now: float) -> float:
        """Return the time since a device's last new time stamp [s]. now: time on the robot's clock [s]."""
        stamp, since = self._stamps.get(part, (np.nan, now))
        if stamp != state.device_time:
            stamp, since = self._stamps[part] = state.device_time, now
        self.longest_silence[part] = max(self.longest_silence[part], now - since)
        return now - since
