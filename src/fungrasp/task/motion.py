"""Set points that move towards goals within the wrist's speed limits."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import norm, turned_towards
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
        p = self._protocol
        poses = np.empty((steps, *self.pose.shape))
        velocities = np.empty((steps, *self.velocity.shape))
        # A turn has no inertia.
        turns = p.wrist_rotation_speed * duration * np.arange(1, steps + 1)[:, None, None]
        poses[..., 3:] = turned_towards(self.pose[:, 3:], goal[:, 3:], turns)
        position, velocity = self.pose[:, :3], self.velocity
        for i in range(steps):
            velocity = self._velocity(goal[:, :3] - position, velocity, duration)
            position = position + duration * velocity
            poses[i, :, :3], velocities[i] = position, velocity
        self.pose, self.velocity = poses[-1], velocities[-1]
        return poses, velocities

    def _velocity(self, offset: np.ndarray, velocity: np.ndarray, duration: float) -> np.ndarray:
        """During the next step, where the goal is at an offset, all of shape [W, 3].

        The speed v from which the wrist can stop in time obeys ``distance = v^2 / (2 a) + v duration / 2``.
        """
        p = self._protocol
        distance, quarter = norm(offset), duration / 4
        braking = quarter + np.sqrt(quarter**2 + distance / (2 * p.wrist_acceleration))
        time = np.maximum(np.maximum(braking, duration), distance / p.wrist_speed)
        change = offset / time - velocity
        return velocity + change / np.maximum(1.0, norm(change) / (p.wrist_acceleration * duration))
