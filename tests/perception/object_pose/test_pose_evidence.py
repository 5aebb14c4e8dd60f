"""Another pose, or another size of the mesh, that fits almost as well is named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose
from fungrasp.objects import builtin_object, plain_shape
from fungrasp.perception import ObjectEstimate
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.pose_evidence import ambiguity, scale_ambiguity
from fungrasp.perception.object_pose.scoring import PoseScorer

POSE = np.array([0.05, 0.02, 0.6, 1.0, 0.0, 0.0, 0.0])


def about_z(degrees: float) -> np.ndarray:
    turn = Rotation.from_euler("z", degrees, degrees=True).as_quat(scalar_first=True)
    return compose(POSE, np.concatenate([np.zeros(3), turn]))


def said(name: str, *others: tuple[np.ndarray, float]) -> str:
    return str(ambiguity(builtin_object(name), ObjectEstimate(POSE, 0.95, True, others)) or "")


def test_a_nearly_symmetric_object_may_be_the_other_way_round():
    words = said("spray_bottle", (about_z(180), 0.93))
    assert "the object's orientation is ambiguous: rotated by 180 degrees" in words
    millimeters = int(words.split("only ")[1].split(" mm")[0])
    assert 1 <= millimeters <= 10


def test_a_symmetry_and_a_worse_pose_give_no_warning():
    assert said("can", (about_z(70), 0.95)) == ""
    assert said("spray_bottle", (about_z(180), 0.8)) == ""
    assert said("spray_bottle") == ""


@pytest.mark.parametrize("better", [0.95, 0.9])
def test_elsewhere(better):
    away = POSE + np.array([0.03, 0, 0, 0, 0, 0, 0])
    words = said("can", (about_z(40), 0.95), (away, better))
    assert words.startswith("the object's position is ambiguous: elsewhere, ") and " mm away" in words


BAR = object_template(plain_shape("box:160x40x40", 0.2))
BAR_POSE = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])


def scorer(hidden_from: float) -> PoseScorer:
    """Rays at the bar, 0.5 m away before a wall; skin in front of what is right of ``hidden_from`` [m]."""
    x, y = np.meshgrid(np.arange(-0.3, 0.3, 0.01), np.arange(-0.1, 0.1, 0.01))
    directions = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
    seen = BAR.rays.cast(BAR_POSE[None], directions)[0]
    skin = (0.5 * directions[:, 0] > hidden_from).astype(float)
    bar = np.where(np.isfinite(seen), 1.0 - skin, 0.0)
    depth = np.where(skin > 0, 0.42, np.where(bar > 0, seen, 0.8))
    pixels = np.argwhere(np.ones(x.shape, dtype=bool))
    spread, nothing = np.full(len(depth), 0.003), np.zeros(len(depth))
    return PoseScorer(BAR, directions, pixels, depth, spread, bar, skin, nothing, bar[None], nothing, None, 1)


def test_another_length_fits_better_only_where_ends_are_hidden():
    (_, seen), (_, hidden) = (
        scale_ambiguity(scorer(hidden_from), BAR_POSE, 0, BAR_POSE[:3], np.random.default_rng(0))
        for hidden_from in (1.0, -0.05)
    )
    # How thick the bar is away from the camera is never seen: no length fits better or worse.
    assert seen == pytest.approx(0.0, abs=0.01) and hidden > 0.05
