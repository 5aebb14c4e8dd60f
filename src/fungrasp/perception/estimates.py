"""The estimated hand joints and object pose, each with its confidence.

Camera frame: OpenCV (x right, y down, z forward) [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.grasps import HUMAN_JOINTS
from fungrasp.perception.warning import PerceptionWarning

JOINTS = len(HUMAN_JOINTS)

Side = Literal["right", "left"]
"""Which hand of the person."""


@dataclass(frozen=True, eq=False)
class HandEstimate:
    """An estimated hand."""

    joints_camera: np.ndarray
    """Joint centres [m], camera frame, shape [21, 3], in the order of ``HUMAN_JOINTS``."""
    pixels: np.ndarray
    """Where the joints were seen in the image [pixels], shape [21, 2]."""
    confidence: np.ndarray
    """How much each joint can be trusted, 0 to 1, shape [21]."""
    covariance: np.ndarray
    """Covariance of each joint's position [m^2], camera frame, shape [21, 3, 3]."""
    side: Side
    """A left hand is given as it is seen, not mirrored."""
    score: float
    """Confidence that this is a hand in this posture, 0 to 1."""

    def __post_init__(self) -> None:
        _check_shape("HandEstimate", "joints_camera", self.joints_camera, (JOINTS, 3))
        _check_shape("HandEstimate", "pixels", self.pixels, (JOINTS, 2))
        _check_shape("HandEstimate", "confidence", self.confidence, (JOINTS,))
        _check_shape("HandEstimate", "covariance", self.covariance, (JOINTS, 3, 3))
        if self.side not in ("right", "left"):
            raise FungraspError(f"HandEstimate: side must be 'right' or 'left', not {self.side!r}")
        _check_score("HandEstimate", self.score)


@dataclass(frozen=True, eq=False)
class ObjectEstimate:
    """The estimated pose of a known object."""

    pose_camera_object: np.ndarray
    """The best answer: pose of the mesh in the camera frame, shape [7]."""
    score: float
    """Confidence that the best answer is right, 0 to 1."""
    accepted: bool
    """Whether the score passes the threshold."""
    alternatives: tuple[tuple[np.ndarray, float], ...] = ()
    """Other answers that the image does not rule out, best first: pose (shape [7]) and score."""
    residual_m: float = float("nan")
    """Median distance of the object's measured points from the mesh's surface [m]."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """What was uncertain; empty when nothing was."""
    judged: bool = True
    """Whether the score comes from the image's depth; ``perceive`` judges those that are not."""

    @property
    def note(self) -> str:
        """The warnings in one line; empty when there are none."""
        words = "; ".join(map(str, self.warnings))
        return words if self.accepted or not words else f"low confidence: {words}"

    def __post_init__(self) -> None:
        for pose, score in ((self.pose_camera_object, self.score), *self.alternatives):
            _check_shape("ObjectEstimate", "pose", pose, (7,))
            _check_score("ObjectEstimate", score)


def _check_shape(owner: str, field: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    found = np.shape(array)
    if found != shape:
        raise FungraspError(f"{owner}: {field} must have shape {list(shape)}, not {list(found)}")
    if not np.isfinite(array).all():
        raise FungraspError(f"{owner}: {field} has non-finite values")


def _check_score(owner: str, score: float) -> None:
    if not 0.0 <= score <= 1.0:
        raise FungraspError(f"{owner}: a score must be from 0 to 1, not {score}")
