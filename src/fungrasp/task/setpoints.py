"""Servo setpoints, computed from an action in every control period as on a robot's computer."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fungrasp.geometry.arrays import at_least, copied, is_numpy, may_be_any, put_back, rows_like
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    clip,
    interpolate_pose,
    norm,
    quaternion_conjugate,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotation_vector,
    turned_towards,
)
from fungrasp.task.protocol import LiftProtocol


class WristSetpoint:
    """Pose and velocity of W wrist setpoints, world frame."""

    def __init__(self, pose: Array, protocol: LiftProtocol):
        """pose: initial poses, shape [W, 7]."""
        xp = array_namespace(pose)
        self.pose = copied(pose)
        self.velocity = xp.zeros_like(self.pose[:, :3])
        self.turning = xp.zeros_like(self.pose[:, :3])
        """Angular velocity, world frame [rad/s], shape [W, 3]; used if angular acceleration is limited."""
        self._protocol = protocol

    def advance(self, goal: Array, duration: float, steps: int = 1) -> tuple[Array, Array]:
        """Move towards goals on straight lines within the limits of speed and acceleration, braking in time.

        Args:
            goal: goal poses, shape [W, 7].
            duration: duration of a step [s].
            steps: number of steps, S.

        Returns:
            poses, shape [S, W, 7], and velocities [m/s], shape [S, W, 3], at the end of each step.
        """
        p, xp = self._protocol, array_namespace(goal)
        kind = {"dtype": goal.dtype, "device": goal.device}
        poses = xp.empty((steps, *self.pose.shape), **kind)
        if p.wrist_rotation_acceleration is None:
            # Angular acceleration is unlimited.
            number = xp.arange(1, steps + 1, **kind)[:, None, None]
            turns = p.wrist_rotation_speed * duration * number
            poses[..., 3:] = turned_towards(self.pose[:, 3:], goal[:, 3:], turns)
        else:
            poses[..., 3:] = self._turn(goal[:, 3:], p.wrist_rotation_acceleration, duration, steps)
        # Units: one step, and the largest velocity change in a step.
        reach = p.wrist_acceleration * duration
        offset = (goal[:, :3] - self.pose[:, :3]) / (reach * duration)
        velocity = self.velocity / reach
        velocities = xp.empty((steps, *velocity.shape), **kind)
        for i in range(steps):
            change = _wanted(offset, p.wrist_speed / reach) - velocity
            velocity = velocity + change / at_least(norm(change), 1.0)
            offset = offset - velocity
            velocities[i] = velocity
        velocities *= reach
        poses[..., :3] = self.pose[:, :3] + duration * xp.cumsum(velocities, 0)
        self.pose, self.velocity = poses[-1], velocities[-1]
        return poses, velocities

    def _turn(self, goal: Array, acceleration: float, duration: float, steps: int) -> Array:
        """Turn towards goals with limited angular acceleration [rad/s^2], shape [S, W, 4]."""
        p = self._protocol
        reach = acceleration * duration
        shape = (steps, *goal.shape)
        orientations = array_namespace(goal).empty(shape, dtype=goal.dtype, device=goal.device)
        orientation, rate = self.pose[:, 3:], self.turning / reach
        for i in range(steps):
            way = rotation_vector(quaternion_multiply(goal, quaternion_conjugate(orientation)))
            change = _wanted(way / (reach * duration), p.wrist_rotation_speed / reach) - rate
            rate = rate + change / at_least(norm(change), 1.0)
            step = quaternion_from_rotation_vector(rate * reach * duration)
            orientation = orientations[i] = quaternion_multiply(step, orientation)
        self.turning = rate * reach
        return orientations


def _wanted(offset: Array, speed: float) -> Array:
    """Return the velocity towards goals at an offset, shape [W, 3], in units of one step and the
    acceleration. It is limited by the speed and by the stopping distance ``v^2 / 2 + v / 2``, and reaches
    near goals in one step."""
    xp, distance = array_namespace(offset), norm(offset)
    time = xp.maximum(0.25 + xp.sqrt(0.0625 + 0.5 * distance), distance / speed)
    return offset / at_least(time, 1.0)


SETPOINT_PERIOD = 0.02
"""Time between two setpoints of the servos [s]."""


@dataclass(frozen=True, eq=False)
class SetpointSequence:
    """The setpoints of one control period, S of them, in W worlds."""

    goal: Array
    """Final goal of the palm, world frame, shape [W, 7]."""
    palm: Array
    """Setpoints of the palm, world frame, shape [S, W, 7]."""
    palm_velocity: Array
    """Linear velocity of these setpoints, world frame [m/s], shape [S, W, 3]."""
    fingers: Array
    """Setpoints of the independent joints [rad], shape [S, W, U]."""


class SetpointGenerator:
    """Generates the setpoints of W worlds, with delayed actions."""

    def __init__(
        self,
        servo_limits: np.ndarray,
        count: int,
        protocol: LiftProtocol,
        timestep: float = 0.005,
        on: Array | None = None,
    ):
        """
        Args:
            servo_limits: lowest and highest setpoint of each independent joint [rad], shape [U, 2].
            count: W.
            protocol: protocol with the limits of the wrist.
            timestep: timestep of the simulation [s]; setpoints are a whole number of timesteps apart.
            on: array whose library and device are used; NumPy if None.
        """
        self.substeps = round(SETPOINT_PERIOD / timestep)
        """Physics steps between two setpoints."""
        self.period = self.substeps * timestep
        """Time between two setpoints [s]."""
        self.number = round(protocol.control_period / self.period)
        """Number of setpoints in a control period, S."""
        on = np.zeros(1) if on is None else on
        resting = rows_like(on, np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1)))
        self.wrist = WristSetpoint(resting, protocol)
        self._lowest, self._highest = (rows_like(on, limit) for limit in servo_limits.T)
        self.fingers = rows_like(on, np.zeros((count, len(servo_limits))))
        """Last setpoints of the independent joints [rad], shape [W, U]."""
        self.delay = rows_like(on, np.zeros(count))
        """Delay of actions [s], at most a control period, rounded up to whole setpoint periods; shape [W]."""
        self._goal = copied(resting)
        self._finger_rate = array_namespace(resting).zeros_like(self.fingers)

    def begin(
        self, ids: np.ndarray, palm_pose: np.ndarray, velocity: np.ndarray, fingers: np.ndarray
    ) -> None:
        """Start I worlds at given setpoints.

        Args:
            ids: worlds, shape [I].
            palm_pose: palm poses, world frame, shape [I, 7].
            velocity: velocities of the palm, world frame [m/s], shape [I, 3].
            fingers: independent joints [rad], shape [I, U].
        """
        self.wrist.pose[ids], self.wrist.velocity[ids], self.wrist.turning[ids] = palm_pose, velocity, 0.0
        self.fingers[ids] = fingers
        self._goal[ids], self._finger_rate[ids] = palm_pose, 0.0

    def state(self) -> list[Array]:
        """Return a copy of the state, for ``restore``."""
        return [copied(array) for array in self._arrays()]

    def restore(self, which: Array, state: list[Array]) -> None:
        """Restore the state of some worlds. which: shape [W] bool."""
        for array, before in zip(self._arrays(), state, strict=True):
            put_back(array, which, before)

    def _arrays(self) -> list[Array]:
        wrist = self.wrist
        return [wrist.pose, wrist.velocity, wrist.turning, self.fingers, self._goal, self._finger_rate]

    def advance(self, goal: Array, fingers: Array) -> SetpointSequence:
        """Return the setpoints of the next control period and advance to its end.

        Args:
            goal: goals of the palm, world frame, shape [W, 7].
            fingers: targets of the independent joints at the end of the period [rad], shape [W, U].
        """
        xp = array_namespace(goal)
        fingers = clip(fingers, self._lowest, self._highest)
        # Number of setpoint periods after which the action takes effect in each world.
        due = clip(xp.ceil(self.delay / self.period - 1e-9), 0.0, float(self.number))
        times = set(due.tolist()) if is_numpy(due) else set(range(self.number + 1))
        parts: list[tuple[Array, ...]] = []
        # If any action is delayed, each period is computed separately, so that rounding in one world does
        # not depend on the delays of the others.
        ends = range(self.number + 1) if may_be_any(due) else (0, self.number)
        for begin, end in pairwise(ends):
            if begin in times:
                self._take(due == begin, goal, fingers)
            parts.append(self._move(end - begin))
        if self.number in times:
            self._take(due == self.number, goal, fingers)
        palm, velocity, joints = parts[0]
        if len(parts) > 1:
            palm, velocity, joints = (xp.concat(part, axis=0) for part in zip(*parts, strict=True))
        return SetpointSequence(goal, palm, velocity, joints)

    def _move(self, steps: int) -> tuple[Array, Array, Array]:
        """Generate S setpoints: palm, shape [S, W, 7], its velocity, [S, W, 3], and fingers, [S, W, U]."""
        palm, velocity = self.wrist.advance(self._goal, self.period, steps)
        now = self.fingers
        number = array_namespace(now).arange(1, steps + 1, dtype=now.dtype, device=now.device)
        fingers = now + number[:, None, None] * self._finger_rate
        self.fingers = fingers[-1]
        return palm, velocity, fingers

    def _take(self, which: Array, goal: Array, fingers: Array) -> None:
        """Switch to a new action. which: worlds, shape [W] bool."""
        rate = (fingers - self.fingers) / self.number
        where = array_namespace(rate).where
        self._goal = where(which[:, None], goal, self._goal)
        self._finger_rate = where(which[:, None], rate, self._finger_rate)


def more_setpoints(
    palm: np.ndarray, palms: np.ndarray, joints: np.ndarray, fingers: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Resample S setpoints evenly to more setpoints, to slow down a motion.

    Args:
        palm: initial palm pose, shape [7].
        palms: palm setpoints, shape [S, 7].
        joints: initial finger joints [rad], shape [U].
        fingers: finger setpoints [rad], shape [S, U].
        count: number of new setpoints, at least S.

    Returns:
        setpoints of palm, shape [count, 7], and fingers, shape [count, U]; the last ones are unchanged.
    """
    palms, fingers = np.concatenate([palm[None], palms]), np.concatenate([joints[None], fingers])
    when = np.arange(1, count + 1) * (len(palms) - 1) / count
    low = np.minimum(when.astype(int), len(palms) - 2)
    share = (when - low)[:, None]
    return (
        interpolate_pose(palms[low], palms[low + 1], share),
        fingers[low] + share * (fingers[low + 1] - fingers[low]),
    )
