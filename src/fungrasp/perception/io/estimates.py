"""The estimated hand joints and object pose, each with its confidence; and what makes them uncertain.

A warning is a code with values for programs, and a sentence.

Camera frame: OpenCV (x right, y down, z forward) [m].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.grasps import HUMAN_JOINTS

# Sentence of each code, with the names of its values.
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
    "side_not_as_given": "the hand looks like a {seen} one, not a {given} one as was said",
    "side_from_fingers": (
        "the hand looks like a {seen} one, but its fingers bend like those of a {taken} one: taken for a "
        "{taken} one; --hand says which it is"
    ),
    "side_from_depth": "which hand it is: a {side} one fits the depth better; --hand says which it is",
    "hand_size": (
        "by the depth there, the hand is {size:.2f} times as large as an adult's (95 % of adults: {low:.2f} "
        "to {high:.2f}): are the depth's unit and the focal length right?"
    ),
    "colors_swapped": "the hand is blue rather than red: was the color image written as BGR?",
    "cut_off": "the {what} is cut off at the {edge} edge of the image",
    "fingers_bent_backwards": ("the fingers seem to be bent backwards: their landmarks are probably wrong"),
    # The object.
    "object_elsewhere": ("where the object is: {how}, {distance_mm:.0f} mm away, it fits almost as well"),
    "object_orientation": (
        "which way round the object is: turned by {turn_deg:.0f} degrees it fits almost as well, with its "
        "surface only {distance_mm:.0f} mm elsewhere on average"
    ),
    "not_comparable": "it can't be compared with the depth: {problem}",
    "not_searched": "{problem}",
    "no_score": "{said}",
    "low_own_score": "the estimator's own score is {score:.2g}",
    # The scene.
    "no_table": (
        "no table was seen: the camera was taken to be level and the table to be right below the grasp"
    ),
}


@dataclass(frozen=True)
class PerceptionWarning:
    """One reason why a result is uncertain; ``str`` gives the sentence."""

    code: str
    """One of ``MESSAGES``."""
    values: Mapping[str, float | str] = field(default_factory=dict)
    """Numbers and words of the sentence, by name; a name ends with its unit."""

    @classmethod
    def of(cls, code: str, **values: float | str) -> PerceptionWarning:
        """A warning with its values."""
        return cls(code, values)

    def __post_init__(self) -> None:
        if self.code not in MESSAGES:
            raise UnknownNameError("warning", self.code, MESSAGES)

    def __str__(self) -> str:
        return MESSAGES[self.code].format_map(self.values)


JOINTS = len(HUMAN_JOINTS)

Side = Literal["right", "left"]
"""Which hand of the person."""


@dataclass(frozen=True, eq=False)
class HandEstimate:
    """An estimated hand."""

    joints_camera: np.ndarray
    """Joint centers [m], camera frame, shape [21, 3], in the order of ``HUMAN_JOINTS``."""
    pixels: np.ndarray
    """Where the joints were seen in the image [pixels], shape [21, 2]."""
    confidence: np.ndarray
    """Probability that each joint is where it was found, shape [21]: within 20 mm, of the hand that
    ``perceive`` gives."""
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


@dataclass(frozen=True)
class PoseEvidence:
    """Numbers from the image about one pose of the mesh. NaN: not known."""

    hinted: float
    """1 where a mask says which pixels show the object, 0.5 for a box or a click, else 0."""
    explained: float
    """Part of the pixels that show the object whose depth the mesh explains."""
    visible: float
    """Part of the mesh's silhouette beside skin that agrees with the measurement."""
    hidden: float
    """Part of the silhouette that skin hides."""
    pixels: float
    """Measured pixels that the pose explains."""
    rival: float
    """Quality of the best different pose, as a part of this one's."""
    other_size: float
    """How well another size of the mesh explains the image, see ``scale_ambiguity``."""
    other_side: float
    """The same of another length of any side."""
    colored: float
    """1 where the mesh has colors, else 0."""
    edge_width: float
    """How many pixels outlines are wide in the depth image."""
    foreign: float
    """Part of the given mask's pixels that look like hand or background; 0 without a mask."""
    larger: float
    """By how much the outline in the image is larger than the mesh's silhouette, from the middle [pixels of
    an image 640 wide]; negative: smaller."""
    off: float
    """How far the image's outline is from the silhouette's on average, in the eighth of it where that is most
    [pixels of an image 640 wide]."""
    left_over: float
    """How far what shows the object reaches beyond the silhouette, as a part of the mesh's size."""
    mask_piece: float
    """The largest connected piece of the given mask beyond it [pixels]; 0 without a mask. A thing that goes
    on behind a finger shows again on its other side."""


@dataclass(frozen=True, eq=False)
class ObjectEstimate:
    """The estimated pose of a known object."""

    pose_camera_object: np.ndarray
    """The best answer: pose of the mesh in the camera frame, shape [7]."""
    score: float
    """How clearly the best answer explains the image, 0 to 1, see ``acceptance.object_score``."""
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
    evidence: PoseEvidence | None = None
    """What the score is made of, where the image's depth gave it."""

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
