"""From simulation to reality: worlds that differ from the nominal ones."""

from fungrasp.transfer.pose_noise import offset_pose, shift_on_table
from fungrasp.transfer.randomization import (
    MODERATE,
    NOMINAL,
    ROBUSTNESS,
    WIDE,
    EpisodeSample,
    MeasurementError,
    Randomization,
    Range,
    draw,
    draw_each,
    random_stream,
)

__all__ = [
    "MODERATE",
    "NOMINAL",
    "ROBUSTNESS",
    "WIDE",
    "EpisodeSample",
    "MeasurementError",
    "Randomization",
    "Range",
    "draw",
    "draw_each",
    "offset_pose",
    "random_stream",
    "shift_on_table",
]
