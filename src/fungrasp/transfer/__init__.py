"""From simulation to reality: worlds that differ in what no policy is told."""

from fungrasp.transfer.delay import Delay, delay_steps
from fungrasp.transfer.differences import Differences
from fungrasp.transfer.physics import apply, move_table, push_objects, pushes
from fungrasp.transfer.pose_noise import noisy_joints, noisy_object, noisy_wrist, offset_pose, shift_on_table
from fungrasp.transfer.randomization import MILD, NONE, Randomisation, Range, Sample, Spread, sample

__all__ = [
    "MILD",
    "NONE",
    "Delay",
    "Differences",
    "Randomisation",
    "Range",
    "Sample",
    "Spread",
    "apply",
    "delay_steps",
    "move_table",
    "noisy_joints",
    "noisy_object",
    "noisy_wrist",
    "offset_pose",
    "push_objects",
    "pushes",
    "sample",
    "shift_on_table",
]
