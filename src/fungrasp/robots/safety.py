"""The safety filter, which sees every setpoint before it is sent.

It protects against mistakes of software. It is no safety function in the sense of a standard: that is the
robot's own controller, with its limits set, and an emergency stop within reach.

What is checked, and how the robot reacts, is the table under "Safety filter" of docs/deploy.md.
"Hold": the arm brakes and keeps its position, the hand keeps its targets. "Open": the arm holds and the hand
opens. After either the robot is in the state of fault until a person starts anew.
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
"""Commanded speeds may exceed their limits by this factor, for rounding."""

UNPUNCTUAL = 0.005
"""A setpoint may come so much too early, for what clocks and waiting are worth [s]."""

AHEAD = 0.02
"""A pose that was captured so far in the future [s] has a time stamp of another clock."""

LONGEST_STEP = 0.1
"""A goal of a device alone is as far from the one before as the joints get within this time, however long ago
that was [s]."""


def check_posture(palm: np.ndarray, clearance: Clearance, box: Workspace) -> str:
    """What is wrong with where a robot would be, as a phrase; "" for nothing. palm: world frame, shape
    [7]."""
    return outside(palm, box) or clearance.fault(box)


def check_pose(tracked: TrackedPose | None, reference: np.ndarray, time: float, cell: RobotCell) -> str:
    """What is wrong with a tracked pose, from before planning until the fingers close, as a phrase; "" for
    nothing.

    Args:
        tracked: the last pose; None where there was none.
        reference: where the object is taken to be, world frame, shape [7].
        time: of the robot's clock [s].
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
    """What is wrong with what a policy wants, as a phrase; "" if nothing is. What is not finite is found by
    the guard. palm: where it is measured, world frame, shape [7]."""
    far = float(np.linalg.norm(action.palm_goal_world[0, :3] - palm[:3]))
    if far > cell.limits.goal_distance:
        return f"the palm would move by {far:.2f} m at once"
    return ""


class SafetyGuard:
    """Sees every command before it is sent, and remembers what it needs to know of those before. One device
    alone, as one that is tried before anything is grasped, is checked by ``joints``."""

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
            limits: what the drivers of "arm" and "hand" accept, or that of one alone.
            clearance: of a posture: joints of the arm [A] and of the hand [U].
            period: time between setpoints [s].
            palm: where it is with joints of the arm [A], world frame, shape [7]; if None, where commands say.
        """
        self._cell, self._limits, self._clearance, self._palm = cell, limits, clearance, palm
        self._period = period
        self.longest_silence = dict.fromkeys(limits, 0.0)
        """Longest time that a device's time stamp has stood still between setpoints [s]."""
        self.reset()

    def reset(self) -> None:
        """Forget the setpoints before: the robot stands still."""
        self._previous: RobotCommand | None = None
        self._before: RobotCommand | None = None
        self._stamps: dict[str, tuple[float, float]] = {}
        self._last: tuple[np.ndarray, float] | None = None
        self._when, self._saved = -np.inf, 0.0
        self.lost = 0.0
        """Time that has passed before the last setpoint and may not be made up for [s]: what follows has to
        be as much later."""

    def __call__(self, state: RobotState, command: RobotCommand) -> RobotCommand:
        """What may be sent of a command: within the limits of position and speed. Raises: SafetyStop: nothing
        may be sent."""
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
        # Targets of squeezing fingers lie inside what they touch: where the fingers are is what counts.
        gap = self._clearance(allowed.arm, state.hand.positions)
        problem = check_posture(allowed.palm, gap, self._cell.workspace) or self._too_fast(allowed)
        if problem:
            raise SafetyStop(problem)
        self._before, self._previous = self._previous, allowed
        return allowed

    def _check_reading(self, part: str, state: JointState, silence: float) -> None:
        """Refuse what a device says of itself. silence: for how long its time stamp has stood still [s].
        Raises: SafetyStop: a value is not finite or beyond its limit, or the device is silent."""
        # Comparisons with limits don't notice what is not finite.
        values = state.positions, state.velocities, state.device_time, state.torques
        if not all(np.isfinite(v).all() for v in values if v is not None):
            raise SafetyStop(f"what the {part} says is not finite")
        dog = self._cell.watchdog
        if silence > (dog.arm_silence if part == "arm" else dog.hand_silence):
            raise SafetyStop(f"the {part} has been silent for {1e3 * silence:.0f} ms")
        measured = np.zeros(0) if part == "arm" or state.torques is None else state.torques
        if np.abs(measured).max(initial=0.0) > self._cell.limits.hand_torque:
            raise SafetyStop("the torque of a hand joint is beyond its limit", StopKind.OPEN)

    def _within_speed(self, part: str, goal: np.ndarray, last: np.ndarray, elapsed: float) -> np.ndarray:
        """A goal that is no farther from the last one than the joints get meanwhile [rad], shape [U].
        elapsed: since the last one [s]."""
        own = self._cell.limits.arm_speed if part == "arm" else self._cell.limits.hand_speed
        reach = TOLERANCE * np.minimum(self._limits[part].velocity, own) * elapsed
        return np.clip(goal, last - reach, last + reach)

    def _within_limits(self, command: RobotCommand) -> RobotCommand:
        """A setpoint within the limits of joint positions and speeds, the palm where it is then."""
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
            # What is checked is what will be sent.
            parts["palm"] = self._palm(parts["arm"])
        return replace(command, **parts)

    def _too_fast(self, command: RobotCommand) -> str:
        """What of a setpoint is too fast to be clipped, as a phrase."""
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
        """Limits of speed are those of a step only where steps are not made up for in a burst. now: time of
        the robot's clock [s]. Raises: SafetyStop: setpoints come too fast."""
        saved = self._saved + now - self._when - self._period
        self._when = now
        # What is so late that it may not be made up for begins anew.
        self.lost = saved if saved > self._cell.watchdog.late_tick else 0.0
        self._saved = 0.0 if self.lost else saved
        if self._saved < -UNPUNCTUAL:
            raise SafetyStop(f"setpoints come in less than {1e3 * self._period:.0f} ms")

    def joints(self, part: str, state: JointState, goal: np.ndarray, now: float) -> np.ndarray:
        """What may be sent of the goal of one device alone, whenever it comes [rad], shape [U].

        Args:
            part: "arm" or "hand".
            goal: finite [rad], shape [U].
            now: time of the robot's clock [s].

        Raises:
            SafetyStop: nothing may.
        """
        silence = self._silence(part, state, now)
        last, when = self._last or (state.positions, -np.inf)
        dog = self._cell.watchdog
        # Between goals nothing is read, so that an old stamp says nothing.
        recent = now - when < (dog.arm_silence if part == "arm" else dog.hand_silence)
        self._check_reading(part, state, silence if recent else 0.0)
        limits, elapsed = self._limits[part], min(now - when, LONGEST_STEP)
        goal = np.clip(goal, limits.lower, limits.upper)
        allowed = self._within_speed(part, goal, last, elapsed)
        self._last = allowed, now
        return allowed

    def _silence(self, part: str, state: JointState, now: float) -> float:
        """How long a device's time stamp has stood still [s]. now: time of the robot's clock [s]."""
        stamp, since = self._stamps.get(part, (np.nan, now))
        if stamp != state.device_time:
            stamp, since = self._stamps[part] = state.device_time, now
        self.longest_silence[part] = max(self.longest_silence[part], now - since)
        return now - since
