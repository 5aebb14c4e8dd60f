"""Where the wrist's speed is limited: setpoints that move towards goals no faster than allowed."""

from __future__ import annotations

from fungrasp.geometry.arrays import at_least, copied
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
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
        """pose: shape [W, 7]."""
        xp = array_namespace(pose)
        self.pose = copied(pose)
        self.velocity = xp.zeros_like(self.pose[:, :3])
        self.turning = xp.zeros_like(self.pose[:, :3])
        """Angular velocity, world frame [rad/s], shape [W, 3]; kept where it may not jump."""
        self._protocol = protocol

    def advance(self, goal: Array, duration: float, steps: int = 1) -> tuple[Array, Array]:
        """Move towards goals: straight, braking in time, never faster than allowed.

        Args:
            goal: poses, shape [W, 7].
            duration: of a step [s].
            steps: S, how many to make.

        Returns:
            pose, shape [S, W, 7], and velocity [m/s], shape [S, W, 3], at the end of each step.
        """
        p, xp = self._protocol, array_namespace(goal)
        kind = {"dtype": goal.dtype, "device": goal.device}
        poses = xp.empty((steps, *self.pose.shape), **kind)
        if p.wrist_rotation_acceleration is None:
            # A turn has no inertia.
            number = xp.arange(1, steps + 1, **kind)[:, None, None]
            turns = p.wrist_rotation_speed * duration * number
            poses[..., 3:] = turned_towards(self.pose[:, 3:], goal[:, 3:], turns)
        else:
            poses[..., 3:] = self._turn(goal[:, 3:], p.wrist_rotation_acceleration, duration, steps)
        # In units of a step and of what the velocity may change in it.
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
        """Turn towards goals as the position moves, with an acceleration [rad/s^2], shape [S, W, 4]."""
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
    """Velocity towards goals at an offset, shape [W, 3], where steps and the acceleration are 1: at most the
    speed, and such that the wrist can stop in time, ``distance = v^2 / 2 + v / 2``, or arrives in a step."""
    xp, distance = array_namespace(offset), norm(offset)
    time = xp.maximum(0.25 + xp.sqrt(0.0625 + 0.5 * distance), distance / speed)
    return offset / at_least(time, 1.0)
