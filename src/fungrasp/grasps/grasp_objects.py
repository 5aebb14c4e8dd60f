"""The objects that a grasp set names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.robot_grasp import RobotGraspSet
from fungrasp.objects import ObjectModel, load_object


def load_objects(
    grasps: HumanGraspSet | RobotGraspSet, folder: str | Path | None = None
) -> dict[str, ObjectModel]:
    """The objects of a grasp set, by name, each with the mass of its first grasp.

    Raises:
        FungraspError: an object can't be found or read.
    """
    names, rows = np.unique(grasps.object_name, return_index=True)
    return {
        str(n): load_object(str(n), float(grasps.object_mass[r]), folder)
        for n, r in zip(names, rows, strict=True)
    }
