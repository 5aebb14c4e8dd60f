"""Worlds that differ from what the policy is told, anew in each trial."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.simulation import Worlds
from fungrasp.transfer.physics import apply, push_objects, pushes
from fungrasp.transfer.pose_noise import noisy_object, noisy_wrist, shift_on_table
from fungrasp.transfer.randomization import Randomisation, Sample, sample


class Differences:
    """What was drawn for the trials that run in W worlds, and the sensors that err accordingly."""

    def __init__(self, randomisation: Randomisation, worlds: Worlds, rng: np.random.Generator):
        """
        Args:
            randomisation: to draw from.
            worlds: whose physics it changes.
            rng: draws everything.
        """
        self.randomisation, self.worlds, self._rng = randomisation, worlds, rng
        self._joints = len(worlds.scene.hand.joint_names)
        self._independent = np.linalg.pinv(worlds.scene.hand.coupling[0])
        self.drawn = sample(randomisation, len(worlds), self._joints, rng)
        """For the trial in each world."""

    def begin(
        self, ids: np.ndarray, object_index: np.ndarray, mass: np.ndarray, fresh: Sample | None = None
    ) -> None:
        """Draw anew for trials that begin; give their worlds the objects, and other joints, servos, tables
        and masses.

        Args:
            ids: worlds, shape [I].
            object_index: which of the scene's objects each holds, shape [I].
            mass: that the policy is told [kg], shape [I].
            fresh: what was drawn, I trials; drawn here if None.
        """
        if fresh is None:
            fresh = sample(self.randomisation, len(ids), self._joints, self._rng)
        self.drawn = self.drawn.replaced(ids, fresh)
        # The fields of an object hold the table's place, too: what was drawn comes after.
        self.worlds.assign(ids, object_index, mass * fresh.mass, fresh.friction)
        apply(fresh, self.worlds, ids)

    def placed(self, ids: np.ndarray, settled_pose: np.ndarray) -> np.ndarray:
        """Where objects really are on the real table, world frame, shape [I, 7].

        Args:
            ids: worlds, shape [I].
            settled_pose: where they are thought to be, world frame, shape [I, 7].
        """
        drawn = self.drawn.select(ids)
        pose = shift_on_table(settled_pose, drawn.object_shift)
        pose[:, 2] += drawn.table_height
        return pose

    def latency(self, ids: np.ndarray, longest: float) -> np.ndarray:
        """From what the policy sees to what the servos do [s], at most ``longest``, shape [I]."""
        drawn = self.drawn.select(ids)
        return np.minimum(drawn.observation_delay + drawn.action_delay, longest)

    def push(self, since_lift: np.ndarray) -> None:
        """Push the objects for the next control period. since_lift: [s], shape [W]; not finite before."""
        d = self.drawn
        push_objects(self.worlds, pushes(d.push, d.push_start, d.push_duration, since_lift))

    def joints(self, joints: np.ndarray) -> np.ndarray:
        """Measured independent joints [rad], shape [W, U]."""
        jitter = self.randomisation.joint_noise.jitter * self._rng.normal(size=joints.shape)
        return joints + self.drawn.joint_bias @ self._independent.T + jitter

    def palm(self, pose: np.ndarray) -> np.ndarray:
        """Measured palm pose, shape [W, 7]."""
        return noisy_wrist(pose, self.drawn, self.randomisation, self._rng)

    def object(self, pose: np.ndarray) -> np.ndarray:
        """Tracked object pose, shape [W, 7]."""
        center = inverse_transform_points(pose, self.worlds.center_of_mass[:, None])[:, 0]
        return noisy_object(pose, self.drawn, self.randomisation, self._rng, center)
