"""Actuation errors between setpoints and joints: lag, calibration errors and backlash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.geometry.arrays import copied, may_be_any, put_back, rows_like
from fungrasp.geometry.poses import Array, array_namespace, clip, interpolate_pose
from fungrasp.sim2real import offset_pose
from fungrasp.task.setpoints import SetpointSequence


class Actuation:
    """Lag, calibration errors and backlash of the servos in W worlds; zero until set.

    The robot's sensors share the calibration errors: they report ``seen_palm`` and add ``encoder_bias``.
    """

    def __init__(self, count: int, joints: int, on: Array | None = None):
        """
        Args:
            count: W.
            joints: U, independent joints of the hand.
            on: array whose library and device are used; NumPy if None.
        """
        on = np.zeros(1) if on is None else on
        none = rows_like(on, np.zeros((count, joints)))
        self.wrist_lag = rows_like(on, np.zeros(count))
        """Time constant with which the wrist follows its setpoints [s], shape [W]."""
        self.wrist_offset = rows_like(on, np.zeros((count, 6)))
        """Offset of the true palm pose from the pose that the arm reports: translation [m], world frame, and
        rotation vector [rad], palm frame, shape [W, 6]."""
        self.encoder_bias = array_namespace(none).zeros_like(none)
        """Encoder readings minus joint positions [rad], shape [W, U]."""
        self.backlash = array_namespace(none).zeros_like(none)
        """Largest difference between a joint and its motor [rad], shape [W, U]."""
        self._pose = rows_like(on, np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1)))
        self._velocity = rows_like(on, np.zeros((count, 3)))
        self._fingers = none

    def begin(
        self, ids: np.ndarray, palm_pose: np.ndarray, velocity: np.ndarray, fingers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start I worlds at their setpoints.

        Args:
            ids: worlds, shape [I].
            palm_pose: setpoint of the palm, world frame, shape [I, 7].
            velocity: velocity of that setpoint [m/s], shape [I, 3].
            fingers: setpoints of the independent joints [rad], shape [I, U].

        Returns:
            True palm poses, shape [I, 7], and independent joints [rad], shape [I, U].
        """
        self._pose[ids], self._velocity[ids], self._fingers[ids] = palm_pose, velocity, fingers
        return self._palm(palm_pose, ids), fingers - self.encoder_bias[ids]

    def state(self) -> list[Array]:
        """Return a copy of the state, for ``restore``."""
        return [copied(array) for array in (self._pose, self._velocity, self._fingers)]

    def restore(self, which: Array, state: list[Array]) -> None:
        """Restore the state of some worlds. which: shape [W] bool."""
        for array, before in zip((self._pose, self._velocity, self._fingers), state, strict=True):
            put_back(array, which, before)

    def follow(self, sequence: SetpointSequence, period: float) -> SetpointSequence:
        """Return the setpoints that wrist and joints actually follow.

        Args:
            sequence: commanded setpoints, S of them.
            period: time between two setpoints [s].
        """
        palm, velocity, fingers = sequence.palm, sequence.palm_velocity, sequence.fingers
        if may_be_any(self.wrist_lag):
            palm, velocity = self._lagging(palm, velocity, period)
        if may_be_any(self.backlash):
            fingers = self._with_play(fingers)
        if may_be_any(self.wrist_offset):
            palm = self._palm(palm)
        if may_be_any(self.encoder_bias):
            fingers = fingers - self.encoder_bias
        return replace(sequence, palm=palm, palm_velocity=velocity, fingers=fingers)

    def seen_palm(self, pose: Array) -> Array:
        """Return the palm poses that the arm reports. pose: true poses, world frame, shape [W, 7]."""
        return offset_pose(pose, -self.wrist_offset) if may_be_any(self.wrist_offset) else pose

    def _palm(self, pose: Array, ids: Array | slice = slice(None)) -> Array:
        """Return the true palm poses. pose: poses that the arm reports."""
        offset = self.wrist_offset[ids]
        if not may_be_any(offset):
            return pose
        return offset_pose(pose, array_namespace(pose).broadcast_to(offset, (*pose.shape[:-1], 6)))

    def _lagging(self, palm: Array, velocity: Array, period: float) -> tuple[Array, Array]:
        """Apply a first-order lag: in each period the wrist covers ``1 - exp(-period / time constant)`` of
        the remaining way, for rotations along the shortest arc."""
        with np.errstate(divide="ignore"):
            xp = array_namespace(palm)
            share = (1.0 - xp.exp(-period / self.wrist_lag))[:, None]
        poses, velocities = [], []
        for goal, speed in zip(palm, velocity, strict=True):
            self._pose = interpolate_pose(self._pose, goal, share)
            self._velocity = self._velocity + share * (speed - self._velocity)
            poses.append(self._pose)
            velocities.append(self._velocity)
        return xp.stack(poses), xp.stack(velocities)

    def _with_play(self, fingers: Array) -> Array:
        """Apply backlash: a joint rests until its motor has crossed the gap, then follows the motor."""
        result = []
        for motor in fingers:
            self._fingers = clip(self._fingers, motor - self.backlash, motor + self.backlash)
            result.append(self._fingers)
        return array_namespace(fingers).stack(result)
