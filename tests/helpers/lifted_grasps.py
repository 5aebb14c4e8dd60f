"""Grasps of a can and a ball that an Allegro hand lifts."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from fungrasp.grasps import HumanGraspSet, RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import retarget


@cache
def allegro_hand() -> Hand:
    return load_hand("allegro")


@cache
def human_grasps() -> HumanGraspSet:
    grasps = builtin_grasps()
    rows = [
        np.flatnonzero(grasps.object_name == name)[i] for name in ("can", "tennis_ball") for i in range(2)
    ]
    return grasps.select(rows)


@cache
def grasped_objects() -> Mapping[str, ObjectModel]:
    return load_objects(human_grasps())


@cache
def good_grasps() -> RobotGraspSet:
    return retarget(human_grasps(), grasped_objects(), allegro_hand())
