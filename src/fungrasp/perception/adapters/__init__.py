"""Other people's estimators: they leave files, or come as packages with an entry point."""

from fungrasp.perception.adapters.entry_point import load_hand_estimator, load_object_pose_estimator
from fungrasp.perception.adapters.hand_placement import read_hand_estimate
from fungrasp.perception.adapters.object_file import read_object_pose

__all__ = [
    "load_hand_estimator",
    "load_object_pose_estimator",
    "read_hand_estimate",
    "read_object_pose",
]
