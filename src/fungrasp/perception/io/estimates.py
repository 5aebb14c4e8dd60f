"""Estimates of hand and object with confidences, and warnings: a code with values, and a sentence.

Camera frame: OpenCV (x right, y down, z forward) [m].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.grasps import HUMAN_JOINTS

# Sentence of each code, with named values.
MESSAGES: Mapping[str, str] = {
    # The files.
    "depth_shifted": (
        "the depth looks shifted by {across}, {down} pixels against the color: is it aligned to it?"
    ),
    "depth_turned": "the depth fits the color better {how}: turn both the same way",
    "lens_distorted": "the lens's distortion is not taken into account; undistort the images",
    "axis_swapped": (
        "cx = {cx:g} and cy = {cy:g} look swapped, or are those of the image before it was turned: each is "
        "nearer to the middle of the other side"
    ),
    "axis_off_centre": (
        "the optical axis, cx = {cx:g} and cy = {cy:g}, is {part:.0f} % of the image from its middle: are "
        "these the intrinsics of the whole image?"
    ),
    # The hand.
    "several_hands": "{count} hands are in the image; the {choice} was taken, at pixel {u:.0f}, {v:.0f}",
    "several_candidates": (
        "{count} hands are in the image; the one that holds the object more likely was taken, at pixel "
        "{u:.0f}, {v:.0f}; a mask or box of the object settles it"
    ),
    "side_not_as_given": "the hand looks like a {seen} hand, but a {given} one was given",
    "side_from_fingers": (
        "the hand looks like a {seen} one, but its fingers bend like those of a {taken} one: taken for a "
        "{taken} one; side (--side) sets it"
    ),
    "side_from_depth": (
        "left or right is ambiguous: a {side} hand fits the depth better; side (--side) sets it"
    ),
    "hand_size": (
        "by the depth there, the hand is {size:.2f} times as large as an adult's (95 % of adults: {low:.2f} "
        "to {high:.2f}): are the depth's unit and the focal length right?"
    ),
    "colors_swapped": "the hand is blue rather than red: was the color image written as BGR?",
    "cut_off": "the {what} is cut off at the {edge} edge of the image",
    "fingers_bent_backwards": ("the fingers seem to be bent backwards: their landmarks are probably wrong"),
    # The object.
    "object_elsewhere": (
        "the object's position is ambiguous: {how}, {distance_mm:.0f} mm away, it fits almost as well"
    ),
    "object_orientation": (
        "the object's orientation is ambiguous: rotated by {turn_deg:.0f} degrees, it fits almost as well, "
        "with its surface only {distance_mm:.0f} mm elsewhere on average"
    ),
    "not_comparable": "it can't be compared with the depth: {problem}",
    "not_searched": "{problem}",
    "no_score": "{said}",
    "low_own_score": "the estimator's own score is {score:.2g}",
    # The scene.
    "no_table": "no table was found: a level camera, and a table right below the grasp, are assumed",
}


@dataclass(frozen=True)
class PerceptionWarning:
    """A reason why a result is uncertain; ``str`` gives the sentence."""

    code: str
    """Code, one of ``MESSAGES``."""
    values: Mapping[str, float | str] = field(default_factory=dict)
    """Values in the sentence, by name; a name may end with its unit."""

    @classmethod
    def of(cls, code: str, **values: float | str) -> PerceptionWarning:
        """Create a warning from its values."""
        return cls(code, values)

    def __post_init__(self) -> None:
        if self.code not in MESSAGES:
            raise UnknownNameError("warning", self.code, MESSAGES)

    def __str__(self) -> str:
        return MESSAGES[self.code].format_map(self.values)


JOINTS = len(HUMAN_JOINTS)

Side = Literal["right", "left"]
"""Side of the hand."""


@dataclass(frozen=True, eq=False)
class HandEstimate:
    """Estimate of a hand."""

    joints_camera: np.ndarray
    """Joint centers [m], camera frame, not mirrored, shape [21, 3], in the order of ``HUMAN_JOINTS``."""
    pixels: np.ndarray
    """Joints detected in the image [pixels], shape [21, 2]."""
    confidence: np.ndarray
    """Probability that each joint is right, shape [21]; within 20 mm in the result of ``perceive``."""
    covariance: np.ndarray
    """Covariance of each joint's position [m^2], camera frame, shape [21, 3, 3]."""
    side: Side
    """Side of the hand."""
    score: float
    """Confidence that this is a hand in this pose, 0 to 1."""

    def __post_init__(self) -> None:
        _check_shape("HandEstimate", "joints_camera", self.joints_camera, (JOINTS, 3))
        _check_shape("HandEstimate", "pixels", self.pixels, (JOINTS, 2))
        _check_shape("HandEstimate", "confidence", self.confidence, (JOINTS,))
        _check_shape("HandEstimate", "covariance", self.covariance, (JOINTS, 3, 3))
        if self.side not in ("right", "left"):
            raise FungraspError(f"HandEstimate: side must be 'right' or 'left', not {self.side!r}")
        _check_score("HandEstimate", self.score)


@dataclass(frozen=True)
class PoseEvidence:
    """Evidence from the image for a pose of the mesh. NaN if unknown."""

    hinted: float
    """1 if a mask shows the object, 0.5 for a box or a point, otherwise 0."""
    explained: float
    """Fraction of the object's pixels whose depth the mesh explains."""
    visible: float
    """Fraction of the mesh's silhouette, without skin, that agrees with the measurement."""
    hidden: float
    """Fraction of the silhouette hidden by skin."""
    pixels: float
    """Number of measured pixels that the pose explains."""
    rival: float
    """Quality of the best different pose, as a fraction of this pose's."""
    other_size: float
    """Logarithm of the quality at the best other size of the mesh, relative; see ``scale_ambiguity``."""
    other_side: float
    """The same for the best other length of a side."""
    colored: float
    """1 if the mesh has colors, otherwise 0."""
    edge_width: float
    """Width of steps in the depth image [pixels]."""
    foreign: float
    """Fraction of the mask's pixels that look like hand or background; 0 without a mask."""
    larger: float
    """Expansion of the outline in the image over the mesh's silhouette [pixels of an image 640 wide]."""
    off: float
    """Mean distance between both outlines in the worst eighth [pixels of an image 640 wide]."""
    left_over: float
    """Extent of the object's pixels beyond the silhouette, as a fraction of the mesh's size."""
    mask_piece: float
    """Largest connected piece of the given mask beyond the silhouette [pixels]; 0 without a mask. A thing
    that continues behind a finger is visible again on its other side."""


@dataclass(frozen=True, eq=False)
class ObjectEstimate:
    """Estimate of a known object's pose."""

    pose_camera_object: np.ndarray
    """Pose of the mesh in the camera frame, shape [7]."""
    score: float
    """How clearly the pose explains the image, 0 to 1, see ``acceptance.object_score``."""
    accepted: bool
    """Whether the score is sufficient."""
    alternatives: tuple[tuple[np.ndarray, float], ...] = ()
    """Other poses that the image does not exclude, best first: pose, shape [7], and score."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """Uncertainties; may be empty."""
    judged: bool = True
    """Whether the score comes from the depth image; otherwise ``perceive`` computes it."""
    evidence: PoseEvidence | None = None
    """Evidence for the score, if it comes from the depth image."""

    @property
    def note(self) -> str:
        """Warnings in one line; may be empty."""
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
