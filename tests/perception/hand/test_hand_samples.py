"""Several hands that one image allows: how they stand for the samples, and where they differ."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hand_scenes import hand_scene

from fungrasp.geometry.signed_distance import SignedDistanceGrid
from fungrasp.grasps import builtin_grasps
from fungrasp.perception.hand.contact_evidence import HandSurroundings
from fungrasp.perception.hand.finger_search import representatives
from fungrasp.perception.hand.fit import fit_held_hands
from fungrasp.perception.hand.skeleton import HandEvidence, redrawn


def test_representatives_stand_for_what_is_near_them():
    joints = np.zeros((7, 21, 3))
    joints[:, :, 0] = np.array([0.0, 0.001, 0.049, 0.05, 0.051, 0.052, 0.1])[:, None]
    rows, part = representatives(joints, 3)
    assert rows.tolist() == [0, 4, 6]
    np.testing.assert_allclose(part, [2 / 7, 4 / 7, 1 / 7])
    rows, part = representatives(joints, 1)
    assert rows.tolist() == [0] and part.tolist() == [1.0]


def test_several_hands_differ_where_the_object_hides_them():
    row = int(np.flatnonzero(builtin_grasps().object_name == "can")[0])
    rng = np.random.default_rng(6)
    scene = hand_scene(row, rng)
    grid = SignedDistanceGrid.from_mesh(scene.model.vertices, scene.model.faces, 0.004)
    surroundings = HandSurroundings(grid, scene.pose_camera_object, scene.table)
    fit = partial(fit_held_hands, scene.detected(rng), scene.capture, surroundings, scene.joints)
    hands = fit(4)
    assert 2 <= len(hands) <= 4
    assert sum(probability for _, probability in hands) == pytest.approx(1.0)
    (alone,) = fit(1)
    np.testing.assert_array_equal(alone[0].joints_camera, hands[0][0].joints_camera)
    joints = np.array([hand.joints_camera for hand, _ in hands])
    spread = np.linalg.norm(joints[1:] - joints[0], axis=-1).mean(axis=0)
    lens = scene.capture.intrinsics
    column, line = np.rint(lens.project(scene.joints)).astype(int).T
    hidden = scene.joints[:, 2] - scene.capture.depth[line, column] > 0.022
    assert 3 < hidden.sum() < 18
    assert spread[hidden].mean() > 1.3 * spread[~hidden].mean()


def test_only_random_errors_are_drawn_anew():
    jacobian = np.zeros((4000, 2))
    fixed, random = HandEvidence(np.zeros(4000), jacobian), HandEvidence(np.ones(4000), jacobian, random=True)
    again = redrawn([fixed, random], 3, 2.0)
    assert again[0] is fixed
    errors = again[1].residual - 1.0
    assert errors.std() == pytest.approx(2.0, rel=0.05) and abs(errors.mean()) < 0.1
    np.testing.assert_array_equal(redrawn([fixed, random], 3, 2.0)[1].residual, again[1].residual)
    assert not np.array_equal(redrawn([fixed, random], 4, 2.0)[1].residual, again[1].residual)
