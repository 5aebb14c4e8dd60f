"""The safety filter: a pure function that sees every setpoint before it is sent, and what it remembers.

It protects against mistakes of software. It is no safety function in the sense of a standard: that is the
robot's own controller, with its limits set, and an emergency stop within reach.

| check | reaction |
| --- | --- |
| a value that is not finite, commanded or measured | hold |
| joint beyond its limit | clipped |
| joint speed beyond its limit | clipped (arm and hand) |
| joint acceleration, palm speed beyond their limit | hold |
| setpoint far from the measured joints | hold |
| wrist goal of the policy far from the palm | hold |
| palm outside the workspace box | hold |
| arm near the table, hand below its top | hold |
| arm or hand near the arm itself, or near an obstacle of the cell | hold |
| torque of a hand joint | open |
| device reports that it does not follow | hold |
| time stamp of a device stands still | hold |
| tracked pose stale, lost, doubtful, jumping or turning until the fingers close | hold |
| setpoints in a burst, control period overrun | hold |

"Hold": the arm brakes and keeps its position, the hand keeps its targets. "Open": the arm holds and the hand
opens. After either the robot is in the state of fault until a person starts anew.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

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
from fungrasp.robots.kinematics.arm_model import MARGIN, Clearance, outside
from fungrasp.task import Action
from fungrasp.task.setpoints import SETPOINT_PERIOD

_log = logging.getLogger(__name__)

TOLERANCE = 1.02
"""Commanded speeds may exceed their limits by this factor, for rounding."""

UNPUNCTUAL = 0.005
"""A setpoint may come so much too early, for what clocks and waiting are worth [s]."""

AHEAD = 0.02
"""A pose that was captured so far in the future [s] has a time stamp of another clock."""

LONGEST_STEP = 0.1
"""A goal of a device alone is as far from the one before as the joints get within this time, however long ago
that was [s]."""


@dataclass(frozen=True, eq=False)
class SafetyContext:
    """What is said of a setpoint depends on this besides the state."""

    cell: RobotCell
    """Limits, workspace and watchdog."""
    limits: Mapping[str, JointLimits]
    """What the drivers of "arm" and "hand" accept."""
    previous: RobotCommand | None
    """What was sent last; None at the beginning."""
    before: RobotCommand | None
    """What was sent before that."""
    period: float
    """Time between the last setpoint and this [s]."""
    silence: Mapping[str, float] = field(default_factory=lambda: {"arm": 0.0, "hand": 0.0})
    """How long the time stamps of "arm" and "hand" have stood still [s]."""
    moving: bool = True
    """Whether setpoints really are sent: in a dry run the arm does not follow."""


def check_setpoint(
    state: RobotState, command: RobotCommand, context: SafetyContext, clearance: Clearance
) -> RobotCommand:
    """What may be sent of a setpoint: within the limits of position and speed. A pure function.

    Args:
        clearance: of the robot with the arm as commanded and the fingers as measured.

    Raises:
        SafetyStop: nothing may be sent.
    """
    c = context
    for values in (command.arm, command.hand, command.feedforward, command.palm):
        if not np.isfinite(values).all():
            raise SafetyStop("a setpoint is not finite")
    for part, joints in (("arm", state.arm), ("hand", state.hand)):
        if joints.status is not DeviceStatus.READY:
            said = f": {joints.message}" if joints.message else ""
            raise SafetyStop(f"the {part} does not follow ({joints.status}{said})")
        check_reading(part, joints, c.silence[part], c.cell)
    _check_lead(state, command, c)
    problem = check_posture(command.palm, clearance, c.cell.workspace) or _too_fast(command, c)
    if problem:
        raise SafetyStop(problem)
    return within_limits(command, c)


def _check_lead(state: RobotState, command: RobotCommand, c: SafetyContext) -> None:
    """Raises: SafetyStop: a setpoint is far from the arm, clipped or not."""
    if c.moving and np.abs(command.arm - state.arm.positions).max() > c.cell.limits.setpoint_lead:
        raise SafetyStop("the arm's setpoint is far from where the arm is")


def within_limits(command: RobotCommand, c: SafetyContext) -> RobotCommand:
    """A setpoint of arm and hand within the limits of position and speed; the same one where it is."""
    parts = {}
    for part, limits in c.limits.items():
        given = getattr(command, part)
        allowed = np.clip(given, limits.lower, limits.upper)
        if c.previous is not None:
            allowed = within_speed(part, allowed, getattr(c.previous, part), c.period, limits, c.cell)
        if np.abs(allowed - given).max(initial=0.0) > 1e-9:
            parts[part] = allowed
    return replace(command, **parts) if parts else command


def check_reading(part: str, state: JointState, silence: float, cell: RobotCell) -> None:
    """Refuse what a device says of itself.

    Args:
        part: "arm" or "hand".
        silence: for how long its time stamp has stood still [s].

    Raises:
        SafetyStop: a value is not finite or beyond its limit, or the device is silent.
    """
    # Comparisons with limits don't notice what is not finite.
    values = state.positions, state.velocities, state.device_time, state.torques
    if not all(np.isfinite(v).all() for v in values if v is not None):
        raise SafetyStop(f"what the {part} says is not finite")
    if silence > (cell.watchdog.arm_silence if part == "arm" else cell.watchdog.hand_silence):
        raise SafetyStop(f"the {part} has been silent for {1e3 * silence:.0f} ms")
    measured = np.zeros(0) if part == "arm" or state.torques is None else state.torques
    if np.abs(measured).max(initial=0.0) > cell.limits.hand_torque:
        raise SafetyStop("the torque of a hand joint is beyond its limit", StopKind.OPEN)


def within_speed(
    part: str, goal: np.ndarray, last: np.ndarray, elapsed: float, limits: JointLimits, cell: RobotCell
) -> np.ndarray:
    """A goal that is no farther from the last one than the joints get meanwhile [rad], shape [U].

    Args:
        part: "arm" or "hand".
        goal: [rad], shape [U].
        last: [rad], shape [U].
        elapsed: since the last one [s].
    """
    most = cell.limits.arm_speed if part == "arm" else cell.limits.hand_speed
    reach = TOLERANCE * np.minimum(limits.velocity, most) * elapsed
    return np.clip(goal, last - reach, last + reach)


def check_posture(palm: np.ndarray, clearance: Clearance, box: Workspace) -> str:
    """What is wrong with where a robot would be, as a phrase; "" for nothing.

    Args:
        palm: world frame, shape [7].
    """
    return outside(palm, box) or clearance.fault(box)


def _too_fast(command: RobotCommand, c: SafetyContext) -> str:
    """What of a setpoint is too fast to be clipped, as a phrase."""
    if c.previous is None:
        return ""
    limits = c.cell.limits
    step = float(np.linalg.norm(command.palm[:3] - c.previous.palm[:3]))
    if step > TOLERANCE * limits.palm_speed * c.period:
        return f"the palm would move at {step / c.period:.2f} m/s"
    if c.before is not None:
        change = command.arm - 2.0 * c.previous.arm + c.before.arm
        if np.abs(change).max() > TOLERANCE * limits.setpoint_acceleration * c.period**2:
            fastest = float(np.abs(change).max()) / c.period**2
            return f"an arm joint would accelerate by {fastest:.1f} rad/s^2"
    return ""


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
    ``check_setpoint``.

    Args:
        palm: where it is measured, world frame, shape [7].
    """
    far = float(np.linalg.norm(action.palm_goal_world[0, :3] - palm[:3]))
    if far > cell.limits.goal_distance:
        return f"the palm would move by {far:.2f} m at once"
    return ""


def warn_unguarded(cell: RobotCell) -> None:
    """Say at a start that a cell has no guard."""
    if cell.guard == "off":
        _log.warning("cell '%s' says guard = \"off\": nothing checks what is sent to its devices", cell.name)


class StandingStamp:
    """For how long a device's time stamp has stood still."""

    def __init__(self) -> None:
        self._stamp, self._since = np.nan, np.nan

    def age(self, stamp: float, now: float) -> float:
        """Since when it stands still [s]. stamp: of the device [s]; now: time of the robot's clock [s]."""
        if stamp != self._stamp:
            self._stamp, self._since = stamp, now
        return now - self._since


class SafetyGuard:
    """Sees every command before it is sent, and remembers what ``check_setpoint`` needs to know. One device
    alone, as one that is tried before anything is grasped, is checked by ``joints``."""

    def __init__(
        self,
        cell: RobotCell,
        limits: Mapping[str, JointLimits],
        clearance: Callable[[np.ndarray, np.ndarray], Clearance] = lambda arm, fingers: Clearance(),
        period: float = SETPOINT_PERIOD,
        moving: bool = True,
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
        self._period, self._moving = period, moving
        self.longest_silence = dict.fromkeys(limits, 0.0)
        """Longest time that a device's time stamp has stood still between setpoints [s]."""
        self.reset()

    def reset(self) -> None:
        """Forget the setpoints before: the robot stands still."""
        self._sent: tuple[RobotCommand | None, RobotCommand | None] = (None, None)
        self._stamps = {part: StandingStamp() for part in self._limits}
        self._last: tuple[np.ndarray, float] | None = None
        self._when, self._saved = -np.inf, 0.0
        self.lost = 0.0
        """Time that has passed before the last setpoint and may not be made up for [s]: what follows has to
        be as much later."""

    def __call__(self, state: RobotState, command: RobotCommand) -> RobotCommand:
        """What may be sent of a command. Raises: SafetyStop: nothing may."""
        before, previous = self._sent
        silence = {"arm": self._silence("arm", state.arm, state.time)}
        silence["hand"] = self._silence("hand", state.hand, state.time)
        context = SafetyContext(
            self._cell, self._limits, previous, before, self._period, silence, self._moving
        )
        self._keep_time(state.time)
        if np.isfinite(command.arm).all() and np.isfinite(command.hand).all():
            _check_lead(state, command, context)
            # What is checked is what will be sent.
            allowed = within_limits(command, context)
            if self._palm is not None and allowed.arm is not command.arm:
                allowed = replace(allowed, palm=self._palm(allowed.arm))
            command = allowed
        # Targets of squeezing fingers lie inside what they touch: where the fingers are is what counts.
        fingers = state.hand.positions
        finite = np.isfinite(command.arm).all() and np.isfinite(fingers).all()
        gap = self._clearance(command.arm, fingers) if finite else Clearance(0.0, 0.0, 0.0)
        if not self._moving:
            # In a dry run the fingers stay open, so that where the hand would be is not known.
            gap = replace(gap, hand=MARGIN)
        allowed = check_setpoint(state, command, context, gap)
        self._sent = previous, allowed
        return allowed

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
        check_reading(part, state, silence if recent else 0.0, self._cell)
        limits, elapsed = self._limits[part], min(now - when, LONGEST_STEP)
        goal = np.clip(goal, limits.lower, limits.upper)
        allowed = within_speed(part, goal, last, elapsed, limits, self._cell)
        self._last = allowed, now
        return allowed

    def _silence(self, part: str, state: JointState, now: float) -> float:
        """How long a device's time stamp has stood still [s]."""
        silence = self._stamps[part].age(state.device_time, now)
        self.longest_silence[part] = max(self.longest_silence[part], silence)
        return silence
