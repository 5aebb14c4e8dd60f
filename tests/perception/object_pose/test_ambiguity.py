"""Another pose that fits almost as well is named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose
from fungrasp.objects import builtin_object
from fungrasp.perception import ObjectEstimate
from fungrasp.perception.object_pose.confidence import ambiguity

POSE = np.array([0.05, 0.02, 0.6, 1.0, 0.0, 0.0, 0.0])


def about_z(degrees: float) -> np.ndarray:
    turn = Rotation.from_euler("z", degrees, degrees=True).as_quat(scalar_first=True)
    return compose(POSE, np.concatenate([np.zeros(3), turn]))


def said(name: str, *others: tuple[np.ndarray, float]) -> str:
    return str(ambiguity(builtin_object(name), ObjectEstimate(POSE, 0.95, True, others)) or "")


def test_a_nearly_symmetric_object_may_be_the_other_way_round():
    words = said("spray_bottle", (about_z(180), 0.93))
    assert "which way round the object is: turned by 180 degrees" in words
    millimetres = int(words.split("only ")[1].split(" mm")[0])
    assert 1 <= millimetres <= 10


def test_a_symmetry_and_a_worse_pose_give_no_warning():
    assert said("can", (about_z(70), 0.95)) == ""
    assert said("spray_bottle", (about_z(180), 0.8)) == ""
    assert said("spray_bottle") == ""


@pytest.mark.parametrize("better", [0.95, 0.9])
def test_elsewhere(better):
    away = POSE + np.array([0.03, 0, 0, 0, 0, 0, 0])
    words = said("can", (about_z(40), 0.95), (away, better))
    assert words.startswith("where the object is: elsewhere, ") and " mm away" in words
