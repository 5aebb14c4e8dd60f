"""Imperfect servos: what becomes of setpoints on the way to the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.geometry.arrays import copied, may_be_any, put_back, rows_like
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    clip,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    relative,
    rotation_vector,
)
from fungrasp.sim2real import offset_pose
from fungrasp.task.setpoints import SetpointSequence


class Actuation:
    """Servos of W worlds that lag, are badly calibrated and have play. Perfect ones until told otherwise.

    The robot's own sensors see none of the calibration's errors: ``seen_palm`` and ``encoder_bias`` are what
    sensors add.
    """

    def __init__(self, count: int, joints: int, on: Array | None = None):
        """
        Args:
            count: W.
            joints: U, independent joints of the hand.
            on: an array of the library and the device of the setpoints; NumPy's if None.
        """
        on = np.zeros(1) if on is None else on
        none = rows_like(on, np.zeros((count, joints)))
        self.wrist_lag = rows_like(on, np.zeros(count))
        """Time constant with which the wrist follows its setpoints [s], shape [W]."""
        self.wrist_offset = rows_like(on, np.zeros((count, 6)))
        """Where the palm is, from where the arm believes it: offset [m], world frame, and rotation vector
        [rad], palm frame, shape [W, 6]."""
        self.encoder_bias = array_namespace(none).zeros_like(none)
        """What encoders say beyond where the joints are [rad], shape [W, U]."""
        self.backlash = array_namespace(none).zeros_like(none)
        """How far a joint can be from where its motor has it [rad], shape [W, U]."""
        self._pose = rows_like(on, np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1)))
        self._velocity = rows_like(on, np.zeros((count, 3)))
        self._fingers = none

    def begin(
        self, ids: np.ndarray, palm_pose: np.ndarray, velocity: np.ndarray, fingers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start where the setpoints are, in some worlds, I of them.

        Args:
            ids: worlds, shape [I].
            palm_pose: setpoint of the palm, world frame, shape [I, 7].
            velocity: of that setpoint [m/s], shape [I, 3].
            fingers: setpoints of the independent joints [rad], shape [I, U].

        Returns:
            Where the palm is, shape [I, 7], and the independent joints [rad], shape [I, U].
        """
        self._pose[ids], self._velocity[ids], self._fingers[ids] = palm_pose, velocity, fingers
        return self._palm(palm_pose, ids), fingers - self.encoder_bias[ids]

    def state(self) -> list[Array]:
        """Where the worlds are, for ``restore``."""
        return [copied(array) for array in (self._pose, self._velocity, self._fingers)]

    def restore(self, which: Array, state: list[Array]) -> None:
        """Put some worlds back to a ``state``. which: shape [W] bool."""
        for array, before in zip((self._pose, self._velocity, self._fingers), state, strict=True):
            put_back(array, which, before)

    def follow(self, sequence: SetpointSequence, period: float) -> SetpointSequence:
        """What the servos work towards.

        Args:
            sequence: what they are told, S setpoints.
            period: time between two of them [s].
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
        """Where the arm believes the palm to be. pose: where it is, world frame, shape [W, 7]."""
        return offset_pose(pose, -self.wrist_offset) if may_be_any(self.wrist_offset) else pose

    def _palm(self, pose: Array, ids: Array | slice = slice(None)) -> Array:
        """Where the palm is, of where the arm believes it."""
        offset = self.wrist_offset[ids]
        if not may_be_any(offset):
            return pose
        return offset_pose(pose, array_namespace(pose).broadcast_to(offset, (*pose.shape[:-1], 6)))

    def _lagging(self, palm: Array, velocity: Array, period: float) -> tuple[Array, Array]:
        """A first-order lag: each period the wrist makes the share ``1 - exp(-period / time constant)`` of
        what is left to its setpoint, on the rotation along the shortest arc."""
        with np.errstate(divide="ignore"):
            xp = array_namespace(palm)
            share = (1.0 - xp.exp(-period / self.wrist_lag))[:, None]
        poses, velocities = [], []
        for goal, speed in zip(palm, velocity, strict=True):
            turn = share * rotation_vector(relative(self._pose, goal)[:, 3:])
            position = self._pose[:, :3] + share * (goal[:, :3] - self._pose[:, :3])
            rotation = quaternion_multiply(self._pose[:, 3:], quaternion_from_rotation_vector(turn))
            self._pose = xp.concat([position, rotation], axis=1)
            self._velocity = self._velocity + share * (speed - self._velocity)
            poses.append(self._pose)
            velocities.append(self._velocity)
        return xp.stack(poses), xp.stack(velocities)

    def _with_play(self, fingers: Array) -> Array:
        """The play operator: a joint stays until its motor has taken up the play, then follows behind it."""
        result = []
        for motor in fingers:
            self._fingers = clip(self._fingers, motor - self.backlash, motor + self.backlash)
            result.append(self._fingers)
        return array_namespace(fingers).stack(result)
