"""From simulation to reality: worlds that differ from the nominal ones."""

from fungrasp.sim2real.episode_sample import EpisodeSample, draw, draw_each, random_stream
from fungrasp.sim2real.pose_noise import offset_pose, shift_on_table, tilt_on_table
from fungrasp.sim2real.presets import (
    MODERATE,
    NOMINAL,
    PRESETS,
    REALITY,
    REALITY_ROLLOUTS,
    ROBUSTNESS,
    THREE_PUSHES,
    WIDE,
    ProtocolName,
    preset,
    protocol_conditions,
    protocol_name,
)
from fungrasp.sim2real.randomization import MeasurementError, Randomization, Range

__all__ = [
    "MODERATE",
    "NOMINAL",
    "PRESETS",
    "REALITY",
    "REALITY_ROLLOUTS",
    "ROBUSTNESS",
    "THREE_PUSHES",
    "WIDE",
    "EpisodeSample",
    "MeasurementError",
    "ProtocolName",
    "Randomization",
    "Range",
    "draw",
    "draw_each",
    "offset_pose",
    "preset",
    "protocol_conditions",
    "protocol_name",
    "random_stream",
    "shift_on_table",
    "tilt_on_table",
]
