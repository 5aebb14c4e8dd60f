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

    def advance(self, goal: np.ndarray, duration: float) -> None:
        """Move towards the goal poses [W, 7] for some time [s]: straight, braking in time, never faster than
        allowed."""
        p = self._protocol
        position, quaternion = self.pose[:, :3], self.pose[:, 3:]
        offset = goal[:, :3] - position
        distance = norm(offset)
        reach = p.wrist_acceleration * duration
        speed = np.minimum(
            p.wrist_speed, np.sqrt(reach**2 / 4 + 2 * p.wrist_acceleration * distance) - reach / 2
        )
        wanted = offset / np.maximum(distance, 1e-9) * np.minimum(speed, distance / duration)
        change = wanted - self.velocity
        self.velocity = self.velocity + change * np.minimum(1.0, reach / np.maximum(norm(change), 1e-12))
        turn = rotation_vector(quaternion_multiply(goal[:, 3:], quaternion_conjugate(quaternion)))
        turn = turn * np.minimum(1.0, p.wrist_rotation_speed * duration / np.maximum(norm(turn), 1e-12))
        rotation = quaternion_multiply(quaternion_from_rotation_vector(turn), quaternion)
        self.pose = np.concatenate([position + duration * self.velocity, rotation / norm(rotation)], axis=1)
