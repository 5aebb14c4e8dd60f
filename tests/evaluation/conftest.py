"""Grasps of a can and a ball that an Allegro hand lifts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from fungrasp.grasps import HumanGraspSet, RobotGraspSet, builtin_grasps
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.retarget import load_objects, retarget


@pytest.fixture(scope="session")
def allegro() -> Hand:
    return load_hand("allegro")


@pytest.fixture(scope="session")
def held_by_people() -> HumanGraspSet:
    grasps = builtin_grasps()
    rows = [
        np.flatnonzero(grasps.object_name == name)[i] for name in ("can", "tennis_ball") for i in range(2)
    ]
    return grasps.select(rows)


@pytest.fixture(scope="session")
def things(held_by_people: HumanGraspSet) -> Mapping[str, ObjectModel]:
    return load_objects(held_by_people)


@pytest.fixture(scope="session")
def good(held_by_people: HumanGraspSet, things: Mapping[str, ObjectModel], allegro: Hand) -> RobotGraspSet:
    return retarget(held_by_people, things, allegro)
