"""Object poses from a recording, at the pace at which they were taken."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from fungrasp.files import atomic_path
from fungrasp.formats.numpy_files import read_npz
from fungrasp.robots.device import RobotError, TrackedPose, TrackingStatus


@dataclass(frozen=True, eq=False)
class PoseRecording:
    """Answers of a tracker, in the order in which they came."""

    captured: np.ndarray
    """When the images were taken [s], shape [N], increasing."""
    received: np.ndarray
    """When the answers came [s], shape [N]."""
    pose_world_object: np.ndarray
    """Poses, shape [N, 7]."""
    score: np.ndarray
    """Confidence, 0 to 1, shape [N]."""
    status: np.ndarray
    """Names of ``TrackingStatus``, shape [N]."""

    def __post_init__(self) -> None:
        count = len(self.captured)
        shapes = [np.shape(a) for a in (self.received, self.score, self.status)]
        if count == 0 or shapes != [(count,)] * 3 or self.pose_world_object.shape != (count, 7):
            raise RobotError(
                "a recording of poses needs as many times, poses, scores and states, at least one"
            )
        if not np.isfinite(self.pose_world_object).all() or (np.diff(self.received) < 0).any():
            raise RobotError("a recording of poses holds values that are not finite, or times that run back")


def save_pose_recording(path: str | Path, recording: PoseRecording) -> None:
    """Write a recording as ``.npz``."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file, **{name: getattr(recording, name) for name in PoseRecording.__annotations__}
        )


def load_pose_recording(path: str | Path) -> PoseRecording:
    """Read what ``save_pose_recording`` has written.

    Raises:
        FungraspError: the file is missing, of another kind or inconsistent.
    """
    arrays = read_npz(path, "recording of poses")
    missing = [name for name in PoseRecording.__annotations__ if name not in arrays]
    if missing:
        raise RobotError(f"{path} is no recording of poses: '{missing[0]}' is missing")
    try:
        return PoseRecording(**{name: arrays[name] for name in PoseRecording.__annotations__})
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from error


class PoseReplay:
    """``PoseSource`` of a recording: its first answer comes on connecting, its last stays."""

    def __init__(self, recording: PoseRecording, clock: Callable[[], float] = time.monotonic):
        """
        Args:
            recording: what is played.
            clock: host time [s].
        """
        self.name = "pose replay"
        self._recording, self._clock = recording, clock
        self._began: float | None = None

    def connect(self) -> None:
        """See ``PoseSource.connect``."""
        self._began = self._clock()

    def read(self) -> TrackedPose | None:
        """See ``PoseSource.read``."""
        if self._began is None:
            return None
        r, first = self._recording, self._recording.received[0]
        row = int(np.searchsorted(r.received - first, self._clock() - self._began, side="right")) - 1
        captured = float(r.captured[row] - first + self._began)
        status = TrackingStatus(str(r.status[row]))
        return TrackedPose(r.pose_world_object[row], captured, float(r.score[row]), status)

    def close(self) -> None:
        """See ``PoseSource.close``."""
        self._began = None

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
