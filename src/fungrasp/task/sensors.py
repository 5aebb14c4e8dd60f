"""Simulated sensors with errors, delay and dropouts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from fungrasp.geometry.arrays import at_least, copied, is_numpy, may_be_any, moved_to, rows_like
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    clip,
    interpolate_pose,
    inverse_transform_points,
    like,
)
from fungrasp.sim2real import EpisodeSample, MeasurementError, Randomization, offset_pose
from fungrasp.task.hand_clearance import HandClearance
from fungrasp.task.lift import LiftTask
from fungrasp.task.policy import Observation

UNCOVERED = 0.05
"""Distance of the hand from which a tracker finds a lost object again [m]. A hand closer than this hides much
of an object of 5 to 20 cm from most cameras."""

NO_LIFT = -1.0
"""``Observation.time_since_lift`` before the lift [s]."""


class Jitter(Protocol):
    """Random numbers with the interface of ``numpy.random.Generator``; on a device, its own generator."""

    def normal(self, *, size: tuple[int, int]) -> Array:
        """Draw standard normal numbers."""
        ...

    def random(self, count: int, /) -> Array:
        """Draw numbers from 0 to 1."""
        ...


class SimulatedSensors:
    """Simulates ``Observation``. Biases come from an episode sample; jitter is drawn at every call."""

    def __init__(
        self,
        task: LiftTask,
        randomization: Randomization,
        rng: Jitter | Sequence[np.random.Generator],
    ):
        """
        Args:
            randomization: randomization with jitter and dropouts.
            rng: random generators, one for all worlds or one per world.
        """
        self._task, self._r, self.rng = task, randomization, rng
        on, count = task.time, len(task.engine)
        self._filtered = rows_like(on, np.full((count, 7), np.nan))
        """Output of the tracker's filter, NaN before an episode's first measurement; shape [W, 7]."""
        self._ring: list[Array] = []
        """Object poses at the last setpoints, the newest last; each of shape [W, 7]."""
        self._covered = rows_like(on, np.zeros(count, dtype=bool))
        """Worlds in which the hand has touched the object and is still near it, shape [W]."""
        self._clearance: HandClearance | None = None
        self._last: tuple[Array, Array] | None = None
        """Last seen object poses, shape [W, 7], and their times [s], shape [W]; NaN before the first."""

    def begin(self, ids: np.ndarray) -> None:
        """Reset the sensors of some worlds whose episodes begin. ids: shape [I]."""
        now, ids = self._task.engine.object_pose, moved_to(self._filtered, ids)
        for pose in self._ring:
            pose[ids] = now[ids]
        if self._last is not None:
            self._last[1][ids] = np.nan
        self._filtered[ids] = np.nan
        self._covered[ids] = False

    def resume(self, ids: np.ndarray, rng: Sequence[np.random.Generator] | None = None) -> None:
        """Continue in some worlds after a pause without motion. Tracker states are kept.

        Args:
            ids: worlds, shape [I].
            rng: new random generators, one per world; unchanged if None.
        """
        now = self._task.engine.object_pose
        for pose in self._ring:
            pose[ids] = now[ids]
        if rng is not None and isinstance(self.rng, Sequence):
            streams = list(self.rng)
            for world, stream in zip(ids.tolist(), rng, strict=True):
                streams[world] = stream
            self.rng = streams

    def record(self) -> None:
        """Record object poses and contacts after each setpoint, for trackers that are delayed or lose the
        object."""
        if self._r.tracker_freeze > 0:
            self._covered |= self._task.engine.link_contacts.any(axis=1)
        if not self._r.tracker_delay[1]:
            return
        period = self._task.setpoints.period
        self._ring.append(self._task.engine.object_pose)
        del self._ring[: -(1 + round(self._r.tracker_delay[1] / period))]

    def observe(self, sample: EpisodeSample) -> Observation:
        """Return the current observation. sample: random parameters of the W episodes."""
        task, r = self._task, self._r
        since_lift = at_least(task.time - task.lift_time, NO_LIFT)
        hand, joints = task.scene.hand, task.engine.joint_positions
        if r.joint_error == MeasurementError():
            joints = hand.independent(joints) + task.actuation.encoder_bias
        else:
            joints = hand.independent(joints + sample.joint_bias) + task.actuation.encoder_bias
            joints = joints + r.joint_error.jitter * self._normal(joints.shape[1])
        palm = task.actuation.seen_palm(task.engine.palm_pose)
        if any(e != MeasurementError() for e in (r.palm_position_error, r.palm_rotation_error)):
            errors = (r.palm_position_error, r.palm_rotation_error)
            palm = offset_pose(palm, sample.palm_bias + self._jitter(errors))
        obj, age = self._track(sample)
        return Observation(
            time=copied(task.time),
            time_since_lift=since_lift,
            joint_positions=joints,
            joint_setpoints=copied(task.setpoints.fingers),
            palm_pose=palm,
            palm_setpoint=copied(task.setpoints.wrist.pose),
            object_pose=obj,
            object_pose_age=age,
        )

    def estimated_object_pose(self, pose: np.ndarray, sample: EpisodeSample) -> np.ndarray:
        """Return estimated poses of objects at rest, world frame, shape [W, 7]. Measurements are averaged, so
        that only the bias remains.

        Args:
            pose: true poses, world frame, shape [W, 7].
        """
        if not sample.object_bias.any():
            return pose
        return offset_pose(pose, sample.object_bias, self._center())

    def _track(self, sample: EpisodeSample) -> tuple[Array, Array]:
        """Return tracked object poses, world frame, shape [W, 7], and their age [s], shape [W]."""
        task, r = self._task, self._r
        pose, xp = task.engine.object_pose, array_namespace(task.time)
        age = xp.zeros_like(task.time)
        if r.tracker_delay[1] > 0 and self._ring:
            late = xp.round(sample.tracker_delay / task.setpoints.period)
            late = clip(late, 0.0, len(self._ring) - 1.0)
            index = len(self._ring) - 1 - xp.astype(late, xp.int64)
            pose = xp.stack(self._ring)[index, xp.arange(len(late), device=late.device)]
            age = late * task.setpoints.period
        errors = (r.object_position_error, r.object_rotation_error)
        # In rollouts, the bias comes from a belief and may exceed the randomization's errors.
        if any(e != MeasurementError() for e in errors) or may_be_any(sample.object_bias):
            pose = offset_pose(pose, sample.object_bias + self._jitter(errors), self._center())
        if r.tracker_dropout > 0 or r.tracker_freeze > 0:
            missing = self._lost(sample)
            if r.tracker_dropout > 0 and self._last is not None:
                missing = missing | (self._uniform() < r.tracker_dropout)
            if self._last is not None:
                seen, when = self._last
                # Finished worlds are not measured any more.
                missing = (missing | task.done) & xp.isfinite(when)
                pose = xp.where(missing[:, None], seen, pose)
                age = xp.where(missing, task.time - when, age)
            self._last = copied(pose), task.time - age
        if r.tracker_time_constant > 0:
            pose = self._low_pass(pose)
        return pose, age

    def _lost(self, sample: EpisodeSample) -> Array:
        """Return whether each tracker has lost its object, shape [W] bool."""
        engine, scene = self._task.engine, self._task.scene
        lost = sample.tracker_freezes & self._covered
        if self._r.tracker_freeze > 0 and may_be_any(lost):
            if self._clearance is None:
                self._clearance = HandClearance(scene.hand, scene.models, engine.object_index)
            self._clearance.hold(engine.object_index)
            # On a device, measure all rows: indices would need a synchronization.
            rows = np.flatnonzero(lost) if is_numpy(lost) else slice(None)
            joints = scene.hand.independent(engine.joint_positions[rows])
            near, _ = self._clearance.measure(rows, engine.object_pose[rows], engine.palm_pose[rows], joints)
            self._covered[rows] &= ~(lost[rows] & (near > UNCOVERED))
        return sample.tracker_freezes & self._covered

    def _low_pass(self, pose: Array) -> Array:
        """Filter poses with ``x += (1 - exp(-T / tau)) (measured - x)`` once per control period T, for
        rotations along the shortest arc."""
        xp = array_namespace(pose)
        share = 1.0 - np.exp(-self._task.protocol.control_period / self._r.tracker_time_constant)
        before = xp.where(xp.isfinite(self._filtered), self._filtered, pose)
        self._filtered = interpolate_pose(before, pose, share)
        return copied(self._filtered)

    def _center(self) -> Array:
        """Return centers of mass, the centers of rotation errors, object frame [m], shape [W, 3]."""
        now = self._task.engine.object_pose
        return inverse_transform_points(now, self._task.engine.center_of_mass[:, None])[:, 0]

    def _jitter(self, errors: tuple[MeasurementError, MeasurementError]) -> Array:
        """Draw jitter of position [m] and rotation vector [rad], shape [W, 6]."""
        drawn = self._normal(6)
        return drawn * like(drawn, np.repeat([e.jitter for e in errors], 3))

    def _normal(self, size: int) -> Array:
        count = len(self._task.engine)
        if not isinstance(self.rng, Sequence):
            return self.rng.normal(size=(count, size))
        # Finished episodes draw nothing: the other worlds' durations must not change the random streams.
        going = ~self._task.done
        return np.stack(
            [rng.normal(size=size) if g else np.zeros(size) for rng, g in zip(self.rng, going, strict=True)]
        )

    def _uniform(self) -> Array:
        count = len(self._task.engine)
        if not isinstance(self.rng, Sequence):
            return self.rng.random(count)
        going = ~self._task.done
        return np.array([rng.random() if g else 1.0 for rng, g in zip(self.rng, going, strict=True)])
