"""Smooths and guards the poses of a tracker."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import (
    quaternion_from_rotation_vector,
    quaternion_multiply,
    relative,
    rotation_vector,
)
from fungrasp.robots.device import PoseSource, TrackedPose, TrackingStatus


@dataclass(frozen=True)
class OneEuroSettings:
    """A first-order low-pass whose cutoff rises with speed: smooth at rest, quick in motion.

    cutoff = resting_cutoff + per_speed |speed|; at a constant speed the filtered pose lags by
    1 / (2 pi cutoff) seconds.
    """

    resting_cutoff: float = 1.0
    """At rest [Hz]."""
    per_speed: float = 20.0
    """Of position [Hz s/m]: at 0.1 m/s and 30 Hz a lag of 53 ms, 2 mm of noise become 0.7 mm at rest."""
    per_turn: float = 2.0
    """Of rotation [Hz s/rad]."""
    speed_cutoff: float = 1.0
    """Of the low-pass on speed itself [Hz]."""

    def __post_init__(self) -> None:
        if min(self.resting_cutoff, self.speed_cutoff) <= 0 or min(self.per_speed, self.per_turn) < 0:
            raise FungraspError("the cutoffs of a pose filter are positive, their slopes not negative")

    def lag(self, speed: float, turn: float = 0.0) -> tuple[float, float]:
        """Lag of position and of rotation [s] at a constant speed [m/s] and turn [rad/s]."""
        position = 1.0 / (2 * np.pi * (self.resting_cutoff + self.per_speed * abs(speed)))
        rotation = 1.0 / (2 * np.pi * (self.resting_cutoff + self.per_turn * abs(turn)))
        return position, rotation


class OneEuroPoseFilter:
    """Filters poses [7] with time stamps; rotations along the shortest arc."""

    def __init__(self, settings: OneEuroSettings | None = None):
        """
        Args:
            settings: cutoffs; by default those of ``OneEuroSettings``.
        """
        self.settings = settings or OneEuroSettings()
        self._time = 0.0
        self._pose: np.ndarray | None = None
        self._measured: np.ndarray | None = None
        self._speed, self._turn = np.zeros(3), np.zeros(3)

    def reset(self) -> None:
        """Forget the past."""
        self._pose = self._measured = None
        self._speed, self._turn = np.zeros(3), np.zeros(3)

    def update(self, pose: np.ndarray, now: float) -> np.ndarray:
        """Filtered pose, shape [7].

        Args:
            pose: measured, shape [7].
            now: time of the measurement [s]; one that is not later than the last changes nothing.
        """
        if self._pose is None or self._measured is None:
            self._pose, self._measured, self._time = pose.copy(), pose.copy(), now
            return self._pose.copy()
        elapsed = now - self._time
        if elapsed <= 0:
            return self._pose.copy()
        s = self.settings
        turned = rotation_vector(relative(self._measured, pose)[3:])
        share = _share(s.speed_cutoff, elapsed)
        self._speed += share * ((pose[:3] - self._measured[:3]) / elapsed - self._speed)
        self._turn += share * (turned / elapsed - self._turn)
        move = _share(s.resting_cutoff + s.per_speed * float(np.linalg.norm(self._speed)), elapsed)
        turn = _share(s.resting_cutoff + s.per_turn * float(np.linalg.norm(self._turn)), elapsed)
        away = rotation_vector(relative(self._pose, pose)[3:])
        rotation = quaternion_multiply(self._pose[3:], quaternion_from_rotation_vector(turn * away))
        position = self._pose[:3] + move * (pose[:3] - self._pose[:3])
        self._pose = np.concatenate([position, rotation / np.linalg.norm(rotation)])
        self._measured, self._time = pose.copy(), now
        return self._pose.copy()


@dataclass(frozen=True)
class PoseGate:
    """Which poses are believed."""

    oldest: float = 0.5
    """A capture older than this is of no use [s]."""
    largest_jump: float = 0.05
    """A pose this far from the last, beyond what ``speed`` explains, is a slip of the tracker [m]."""
    largest_turn: float = 0.5
    """The same for rotation [rad]."""
    speed: float = 0.5
    """An object may move so fast [m/s], and turn at ten times this [rad/s]."""
    lowest_score: float = 0.0
    """Poses of less confidence count as lost."""
    confirmations: int = 5
    """A jump that is seen so often at the same place is believed: the object was moved."""


class GuardedPoseSource:
    """``PoseSource`` in front of another: filters its poses; a stale, jumping or unlikely one is lost.

    What is lost keeps the last pose that was believed, with its capture time.
    """

    def __init__(
        self,
        source: PoseSource,
        gate: PoseGate | None = None,
        settings: OneEuroSettings | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):
        """
        Args:
            source: the tracker.
            gate: which poses are believed.
            settings: of the filter.
            clock: host time [s].
        """
        self.name = source.name
        self.gate = gate or PoseGate()
        self._source, self._clock = source, clock
        self._filter = OneEuroPoseFilter(settings)
        self._last: TrackedPose | None = None
        self._raw: TrackedPose | None = None
        self._elsewhere: TrackedPose | None = None
        self._seen, self._reason = 0, ""

    @property
    def reason(self) -> str:
        """Why the last answer was not believed; empty where it was."""
        return self._reason

    def connect(self) -> None:
        """See ``PoseSource.connect``."""
        self._filter.reset()
        self._last = self._raw = self._elsewhere = None
        self._source.connect()

    def read(self) -> TrackedPose | None:
        """See ``PoseSource.read``."""
        pose = self._source.read()
        if pose is None:
            return None
        new = self._raw is None or pose.captured > self._raw.captured
        if self._last is None or new:
            self._reason = self._distrust(pose)
            if not self._reason:
                smooth = self._filter.update(pose.pose_world_object, pose.captured)
                self._last, self._raw = dataclasses.replace(pose, pose_world_object=smooth), pose
        last = self._last or pose
        age = self._clock() - last.captured
        if age > self.gate.oldest:
            self._reason = self._reason or f"the pose is {age:.2f} s old"
        if self._reason:
            return dataclasses.replace(last, status=TrackingStatus.LOST, score=0.0)
        return last

    def close(self) -> None:
        """See ``PoseSource.close``."""
        self._source.close()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _distrust(self, pose: TrackedPose) -> str:
        if pose.status is not TrackingStatus.TRACKING:
            return f"the tracker says {pose.status}"
        if pose.score < self.gate.lowest_score:
            return f"the tracker's score is {pose.score:.2f}"
        if self._raw is None or self._near(self._raw, pose):
            self._elsewhere, self._seen = None, 0
            return ""
        same = self._elsewhere is not None and self._near(self._elsewhere, pose)
        if not same or (self._elsewhere is not None and pose.captured > self._elsewhere.captured):
            self._seen = self._seen + 1 if same else 1
            self._elsewhere = pose
        if self._seen >= self.gate.confirmations:
            self._filter.reset()
            self._elsewhere, self._seen = None, 0
            return ""
        return "the pose has jumped"

    def _near(self, before: TrackedPose, after: TrackedPose) -> bool:
        elapsed = max(after.captured - before.captured, 0.0)
        moved = relative(before.pose_world_object, after.pose_world_object)
        far = self.gate.largest_jump + self.gate.speed * elapsed
        turn = self.gate.largest_turn + 10 * self.gate.speed * elapsed
        return (
            float(np.linalg.norm(moved[:3])) < far
            and float(np.linalg.norm(rotation_vector(moved[3:]))) < turn
        )


def _share(cutoff: float, elapsed: float) -> float:
    """Weight of a new sample in a first-order low-pass of a cutoff [Hz]."""
    return 1.0 - float(np.exp(-2 * np.pi * cutoff * elapsed))
