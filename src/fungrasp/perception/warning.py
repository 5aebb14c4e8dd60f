"""What makes a perceived grasp uncertain: a code with values for programs, and a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fungrasp.errors import UnknownNameError

MESSAGES: Mapping[str, str] = {
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
    "fingers_bent_backwards": ("the fingers seem to be bent backwards: their landmarks are probably wrong"),
    "low_hand_score": "the hand: its score is only {score:.2f}",
    # The object.
    "object_not_accepted": "the object's pose: {reason}",
    "object_elsewhere": ("where the object is: {how}, {distance_mm:.0f} mm away, it fits almost as well"),
    "object_orientation": (
        "which way round the object is: turned by {turn_deg:.0f} degrees it fits almost as well, with its "
        "surface only {distance_mm:.0f} mm elsewhere on average"
    ),
    "not_comparable": "it can't be compared with the depth: {problem}",
    "not_searched": "{problem}",
    "poorly_explained": "the mesh explains {percent:.0f} % of {what}; wrong mesh?",
    "mask_loose": (
        "the mask is loose: {percent:.0f} % of it look like hand or background; draw it tighter, or give a "
        "box or a point instead"
    ),
    "depth_smoothed": (
        "the depth was smoothed: its outlines are {pixels:.0f} pixels wide; turn off the camera's spatial "
        "and hole-filling filters"
    ),
    "contradicted": "the mesh would hide things that were seen behind it",
    "far_from_fingertips": "the fingertips are {distance_mm:.0f} mm from the object's surface",
    "rival_pose": "another pose fits as well",
    "few_pixels": "only {pixels:.0f} pixels show the object",
    "little_seen": "too little of the object is seen for a clear answer",
    "no_score": "{said}",
    "low_own_score": "the estimator's own score is {score:.2g}",
    "other_given_pose_fits": "another of the program's poses fits, with a score of {score:.2f}",
    # The scene.
    "no_table": (
        "no table was seen: the camera was taken to be level and the table to be right below the grasp"
    ),
}
"""Sentence of each code, with the names of its values."""


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
