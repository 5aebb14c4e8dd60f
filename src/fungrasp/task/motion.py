"""Set points that move towards goals within the wrist's speed limits."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import (
    norm,
    quaternion_conjugate,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotation_vector,
)
from fungrasp.task.protocol import Protocol


class WristSetPoint:
    """Pose and velocity of W wrist set points, world frame."""

    def __init__(self, pose: np.ndarray, protocol: Protocol):
        """pose: shape [W, 7]."""
        self.pose = pose.copy()
        self.velocity = np.zeros((len(pose), 3))
        self._protocol = protocol

    def advance(self, goal: np.ndarray, duration: float, steps: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Move towards goals: straight, braking in time, never faster than allowed.

        Args:
            goal: poses, shape [W, 7].
            duration: of a step [s].
            steps: S, how many to make.

        Returns:
            pose, shape [S, W, 7], and velocity [m/s], shape [S, W, 3], at the end of each step.
        """
        poses = np.empty((steps, *self.pose.shape))
        velocities = np.empty((steps, *self.velocity.shape))
        poses[..., 3:] = self._turned(goal[:, 3:], duration, steps)
        position, velocity = self.pose[:, :3], self.velocity
        for i in range(steps):
            velocity = self._velocity(goal[:, :3] - position, velocity, duration)
            position = position + duration * velocity
            poses[i, :, :3], velocities[i] = position, velocity
        self.pose, self.velocity = poses[-1], velocities[-1]
        return poses, velocities

    def _velocity(self, offset: np.ndarray, velocity: np.ndarray, duration: float) -> np.ndarray:
        """During the next step, where the goal is at an offset, all of shape [W, 3]."""
        p = self._protocol
        distance = norm(offset)
        reach = p.wrist_acceleration * duration
        speed = np.minimum(
            p.wrist_speed, np.sqrt(reach**2 / 4 + 2 * p.wrist_acceleration * distance) - reach / 2
        )
        wanted = offset / np.maximum(distance, 1e-9) * np.minimum(speed, distance / duration)
        change = wanted - velocity
        return velocity + change * np.minimum(1.0, reach / np.maximum(norm(change), 1e-12))

    def _turned(self, goal: np.ndarray, duration: float, steps: int) -> np.ndarray:
        """Orientations after each step, shape [S, W, 4]: all on one way, as the turn has no inertia."""
        quaternion = self.pose[:, 3:]
        turn = rotation_vector(quaternion_multiply(goal, quaternion_conjugate(quaternion)))
        reach = self._protocol.wrist_rotation_speed * duration * np.arange(1, steps + 1)[:, None, None]
        turn = turn * np.minimum(1.0, reach / np.maximum(norm(turn), 1e-12))
        rotation = quaternion_multiply(quaternion_from_rotation_vector(turn), quaternion)
        return rotation / norm(rotation)
