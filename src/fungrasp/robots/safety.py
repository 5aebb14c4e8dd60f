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
| torque of an arm joint | hold |
| torque of a hand joint | open |
| device reports that it does not follow | hold |
| time stamp of a device stands still | hold |
| tracked pose stale, lost, doubtful, jumping or turning until the fingers close | hold |
| control period overrun | hold |

"Hold": the arm brakes and keeps its position, the hand keeps its targets. "Open": the arm holds and the hand
opens. After either the robot is in the state of fault until a person starts anew.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from fungrasp.geometry.poses import relative, rotation_vector
from fungrasp.robots.cell import RobotCell, Workspace
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, StopKind, TrackedPose
from fungrasp.robots.kinematics.arm_model import MARGIN, Clearance
from fungrasp.robots.robot_state import RobotCommand, RobotState, SafetyStop
from fungrasp.task import Action

_log = logging.getLogger(__name__)

TOLERANCE = 1.02
"""Commanded speeds may exceed their limits by this factor, for rounding."""


class Reaction(StrEnum):
    """What the filter does with a setpoint."""

    SEND = "send"
    """Nothing."""
    CLIP = "clip"
    """Another setpoint is sent, within the limits."""
    HOLD = "hold"
    """The arm brakes and keeps its position, the hand keeps its targets."""
    OPEN = "open"
    """The arm brakes and keeps its position, the hand opens."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the filter says of a setpoint."""

    command: RobotCommand
    """What may be sent."""
    reaction: Reaction
    """What to do."""
    reason: str = ""
    """Why, as a phrase; "" where nothing was wrong."""


@dataclass(frozen=True, eq=False)
class SafetyContext:
    """What a verdict depends on besides state and setpoint."""

    cell: RobotCell
    """Limits, workspace and watchdog."""
    arm: JointLimits
    """What the arm's driver accepts."""
    hand: JointLimits
    """What the hand's driver accepts."""
    previous: RobotCommand | None
    """What was sent last; None at the beginning."""
    before: RobotCommand | None
    """What was sent before that."""
    period: float
    """Time between the last setpoint and this [s]."""
    arm_silence: float = 0.0
    """How long the arm's time stamp has stood still [s]."""
    hand_silence: float = 0.0
    """How long the hand's time stamp has stood still [s]."""
    moving: bool = True
    """Whether setpoints really are sent: in a dry run the arm does not follow."""


def check_setpoint(
    state: RobotState, command: RobotCommand, context: SafetyContext, clearance: Clearance
) -> Verdict:
    """The verdict on a setpoint. A pure function.

    Args:
        state: what the devices say.
        command: the setpoint.
        context: limits and the setpoints before.
        clearance: of the robot with the arm as commanded and the fingers as measured.
    """
    c, limits, dog = context, context.cell.limits, context.cell.watchdog
    for values in (command.arm, command.hand, command.feedforward, command.palm):
        if not np.isfinite(values).all():
            return Verdict(command, Reaction.HOLD, "a setpoint is not finite")
    for name, joint, silence, most in (
        ("arm", state.arm, c.arm_silence, dog.arm_silence),
        ("hand", state.hand, c.hand_silence, dog.hand_silence),
    ):
        if not joint_state_finite(joint):
            return Verdict(command, Reaction.HOLD, f"what the {name} says is not finite")
        if joint.status is not DeviceStatus.READY:
            said = f": {joint.message}" if joint.message else ""
            return Verdict(command, Reaction.HOLD, f"the {name} does not follow ({joint.status}{said})")
        if silence > most:
            return Verdict(command, Reaction.HOLD, f"the {name} has been silent for {1e3 * silence:.0f} ms")
    if torque_beyond(state.arm.torques, limits.arm_torque):
        return Verdict(command, Reaction.HOLD, "the torque of an arm joint is beyond its limit")
    if torque_beyond(state.hand.torques, limits.hand_torque):
        return Verdict(command, Reaction.OPEN, "the torque of a hand joint is beyond its limit")
    if c.moving and np.abs(command.arm - state.arm.positions).max() > limits.setpoint_lead:
        return Verdict(command, Reaction.HOLD, "the arm's setpoint is far from where the arm is")
    problem = check_posture(command.palm, clearance, context.cell.workspace)
    if problem:
        return Verdict(command, Reaction.HOLD, problem)
    too_fast = _too_fast(command, c)
    if too_fast:
        return Verdict(command, Reaction.HOLD, too_fast)
    return _clipped(command, c)


def check_posture(palm: np.ndarray, clearance: Clearance, box: Workspace) -> str:
    """What is wrong with where a robot would be, as a phrase; "" for nothing.

    Args:
        palm: world frame, shape [7].
        clearance: of the robot there.
        box: where it may be.
    """
    if (palm[:3] < box.lower).any() or (palm[:3] > box.upper).any():
        return "the palm would leave the workspace box"
    if clearance.table < box.table_clearance:
        return "the arm would touch the table"
    if clearance.hand < -box.hand_depth:
        return "the hand would press into the table, or come too near to it"
    if clearance.obstacle < box.table_clearance:
        return "the arm or the hand would touch an obstacle"
    if clearance.itself < 0.0:
        return "the arm or the hand would touch the arm"
    return ""


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


def _clipped(command: RobotCommand, c: SafetyContext) -> Verdict:
    """The setpoint within the limits of position and speed."""
    parts = {}
    speeds = {"arm": c.cell.limits.arm_speed, "hand": c.cell.limits.hand_speed}
    for name, limits in (("arm", c.arm), ("hand", c.hand)):
        given = getattr(command, name)
        allowed = np.clip(given, limits.lower, limits.upper)
        if c.previous is not None:
            last = getattr(c.previous, name)
            reach = np.minimum(limits.velocity, speeds[name]) * c.period * TOLERANCE
            allowed = np.clip(allowed, last - reach, last + reach)
        if np.abs(allowed - given).max(initial=0.0) > 1e-9:
            parts[name] = allowed
    if not parts:
        return Verdict(command, Reaction.SEND)
    return Verdict(replace(command, **parts), Reaction.CLIP, f"{' and '.join(parts)} clipped to limits")


def check_pose(tracked: TrackedPose | None, reference: np.ndarray, time: float, cell: RobotCell) -> str:
    """What is wrong with a tracked pose, from before planning until the fingers close, as a phrase; "" for
    nothing.

    Args:
        tracked: the last pose; None where there was none.
        reference: where the object is taken to be, world frame, shape [7].
        time: of the robot's clock [s].
        cell: with the watchdog.
    """
    if tracked is None:
        return "the tracker has not seen the object"
    if not np.isfinite([*tracked.pose_world_object, tracked.captured, tracked.score]).all():
        return "the tracked pose is not finite"
    age = time - tracked.captured
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


def check_action(action: Action, palm: np.ndarray, cell: RobotCell) -> str:
    """What is wrong with what a policy wants, as a phrase; "" if nothing is. What is not finite is found by
    ``check_setpoint``.

    Args:
        action: of one robot.
        palm: where it is measured, world frame, shape [7].
        cell: with the limits.
    """
    far = float(np.linalg.norm(action.palm_goal[0, :3] - palm[:3]))
    if far > cell.limits.goal_distance:
        return f"the palm would move by {far:.2f} m at once"
    return ""


def joint_state_finite(state: JointState) -> bool:
    """Whether all that a device measures is finite: comparisons with limits don't notice what is not."""
    values = state.positions, state.velocities, state.device_time, state.torques
    return all(np.isfinite(v).all() for v in values if v is not None)


def torque_beyond(torques: np.ndarray | None, limit: float) -> bool:
    """Whether a measured torque is beyond a limit [N m]. torques: shape [U]; None where none is measured."""
    return torques is not None and bool(np.abs(torques).max(initial=0.0) > limit)


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
    """Sees every command before it is sent, and remembers what ``check_setpoint`` needs to know."""

    def __init__(
        self,
        cell: RobotCell,
        arm: JointLimits,
        hand: JointLimits,
        clearance: Callable[[np.ndarray, np.ndarray], Clearance],
        period: float,
        moving: bool = True,
    ):
        """
        Args:
            cell: limits, workspace and watchdog.
            arm: what the arm's driver accepts.
            hand: what the hand's driver accepts.
            clearance: of a posture: joints of the arm [A] and of the hand [U].
            period: time between setpoints [s].
            moving: whether setpoints really are sent.
        """
        self._cell, self._arm, self._hand, self._clearance = cell, arm, hand, clearance
        self._period, self._moving = period, moving
        self._sent: tuple[RobotCommand | None, RobotCommand | None] = (None, None)
        self._stamps = {"arm": StandingStamp(), "hand": StandingStamp()}
        self.verdict: Verdict | None = None
        """The last one."""
        self.longest_silence = {"arm": 0.0, "hand": 0.0}
        """Longest time that a device's time stamp has stood still between setpoints [s]."""

    def reset(self) -> None:
        """Forget the setpoints before: the robot stands still."""
        self._sent = (None, None)
        self._stamps = {"arm": StandingStamp(), "hand": StandingStamp()}

    def __call__(self, state: RobotState, command: RobotCommand) -> RobotCommand:
        """What may be sent of a command. Raises: SafetyStop: nothing may."""
        before, previous = self._sent
        context = SafetyContext(
            self._cell,
            self._arm,
            self._hand,
            previous,
            before,
            self._period,
            self._silence("arm", state.arm.device_time, state.time),
            self._silence("hand", state.hand.device_time, state.time),
            self._moving,
        )
        # Targets of squeezing fingers lie inside what they touch: where the fingers are is what counts.
        fingers = state.hand.positions
        finite = np.isfinite(command.arm).all() and np.isfinite(fingers).all()
        gap = self._clearance(command.arm, fingers) if finite else Clearance(0.0, 0.0, 0.0)
        if not self._moving:
            # In a dry run the fingers stay open, so that where the hand would be is not known.
            gap = replace(gap, hand=MARGIN)
        self.verdict = verdict = check_setpoint(state, command, context, gap)
        if verdict.reaction in (Reaction.HOLD, Reaction.OPEN):
            kind = StopKind.OPEN if verdict.reaction is Reaction.OPEN else StopKind.HOLD
            raise SafetyStop(verdict.reason, kind)
        self._sent = previous, verdict.command
        return verdict.command

    def _silence(self, name: str, stamp: float, now: float) -> float:
        """How long a device's time stamp has stood still [s]."""
        silence = self._stamps[name].age(stamp, now)
        self.longest_silence[name] = max(self.longest_silence[name], silence)
        return silence
