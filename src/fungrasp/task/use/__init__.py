"""The use test: after the hold, the wrist plays the motion of the grasp's task."""

from fungrasp.task.use.episode import TABLE_AWAY, play_use
from fungrasp.task.use.motion import USE_MOTIONS, UseMotion, load_use_motions, motion_of
from fungrasp.task.use.outcome import (
    LARGEST_SHIFT,
    LARGEST_TURN,
    UseOutcomes,
    displacement,
    moved_too_far,
)

__all__ = [
    "LARGEST_SHIFT",
    "LARGEST_TURN",
    "TABLE_AWAY",
    "USE_MOTIONS",
    "UseMotion",
    "UseOutcomes",
    "displacement",
    "load_use_motions",
    "motion_of",
    "moved_too_far",
    "play_use",
]
