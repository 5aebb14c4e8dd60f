"""Other people's estimators: they leave files, or come as packages with an entry point."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

import trimesh

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.objects import ObjectModel
from fungrasp.perception.adapters.hand_file import read_hand_estimate
from fungrasp.perception.adapters.object_file import read_object_pose
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate

__all__ = ["load_hand_estimator", "load_object_pose_estimator", "read_hand_estimate", "read_object_pose"]

HAND_GROUP = "fungrasp.hand_estimators"
OBJECT_POSE_GROUP = "fungrasp.object_pose_estimators"

HandEstimator = Callable[[Capture], HandEstimate]
"""Takes the capture; finds one hand in it. Raises ``FungraspError`` if there is none."""

ObjectPoseEstimator = Callable[[Capture, ObjectModel | trimesh.Trimesh], ObjectEstimate]
"""Takes the capture and the object's mesh [m]."""


def load_hand_estimator(name: str) -> HandEstimator:
    """A hand estimator by the name of its entry point.

    Raises:
        FungraspError: no installed package has it, or it can't be loaded.
    """
    return _load(HAND_GROUP, "hand estimator", name)


def load_object_pose_estimator(name: str) -> ObjectPoseEstimator:
    """An estimator of object poses by the name of its entry point. Raises as ``load_hand_estimator``."""
    return _load(OBJECT_POSE_GROUP, "object pose estimator", name)


def _load(group: str, kind: str, name: str) -> Any:
    found = {entry.name: entry for entry in entry_points(group=group)}
    if not found:
        raise FungraspError(f"no {kind} '{name}': no installed package brings any (entry point {group})")
    if name not in found:
        raise UnknownNameError(kind, name, found)
    try:
        return found[name].load()
    except ImportError as error:
        raise FungraspError(f"the {kind} '{name}' can't be loaded: {' '.join(str(error).split())}") from error
