"""Captures for the verdict: small shapes are in a pinch."""

import numpy as np
import pytest

from benchmarks.perception.verdict_captures import PINCH, SKIN, pinch_width, small_shape
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps import builtin_grasps
from fungrasp.grasps.human_hand import HUMAN_JOINTS


def test_a_small_shape_is_between_thumb_and_two_fingers():
    tips = [HUMAN_JOINTS.index(name) for name in ("thumb_tip", "index_tip", "middle_tip")]
    pinches = [grasp for grasp in builtin_grasps() if PINCH[0] < pinch_width(grasp.hand_joints) < PINCH[1]]
    assert len(pinches) > 5
    for seed, grasp in enumerate(pinches[:5]):
        held, model = small_shape(grasp, np.random.default_rng(seed))
        thumb, index, middle = inverse_transform_points(held.object_pose, held.hand_joints[tips])
        fingers = 0.5 * (index + middle)
        # The shape's x axis goes from the thumb to the fingers.
        assert fingers[0] - thumb[0] == pytest.approx(model.size[0] + 2 * SKIN, abs=0.002)
        assert np.abs(0.5 * (fingers + thumb)).max() < 1e-6
