"""What is probable for a finger behind an object: the mixture, the package's weights, and hands drawn so."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
from hand_scenes import hand_scene

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.geometry.signed_distance import SignedDistanceGrid
from fungrasp.grasps import builtin_grasps
from fungrasp.objects import builtin_object
from fungrasp.perception.hand.contact_evidence import HandSurroundings
from fungrasp.perception.hand.finger_prior import (
    WEIGHTS,
    FingerPrior,
    PostureMixture,
    from_free,
    shipped_prior,
    surface_features,
    to_free,
    with_usual,
)
from fungrasp.perception.hand.fit import fit_held_hands, skeleton_through
from fungrasp.perception.hand.hand_samples import representatives
from fungrasp.perception.hand.skeleton import ANGLE_MEAN, ANGLE_SPREAD


def test_density_of_a_known_mixture():
    # Two components of the thumb's five angles; covariances E and E / 4.
    mean = np.zeros((2, 5))
    mean[1, 1] = 3.0
    factor = np.stack([np.eye(5), 2.0 * np.eye(5)])
    mixture = PostureMixture(4, np.log([0.25, 0.75]), mean, factor)
    usual = ANGLE_MEAN[4][None]
    peak = (2 * np.pi) ** -2.5
    expected = 0.25 * peak + 0.75 * 32 * peak * np.exp(-0.5 * 4 * 9)
    assert mixture.log_density(usual)[0] == pytest.approx(np.log(expected))
    assert mixture.component(ANGLE_MEAN[4]) == 0
    there = ANGLE_MEAN[4].copy()
    there[0, 1] += 3.0 * ANGLE_SPREAD[4, 0, 1]
    assert mixture.component(there) == 1


def test_draws_are_those_of_the_mixture():
    covariance = np.eye(4)
    covariance[:2, :2] = [[4.0, 1.0], [1.0, 1.0]]
    factor = np.linalg.cholesky(np.linalg.inv(covariance))
    mixture = PostureMixture(1, np.zeros(1), np.array([[1.0, 0, 0, -1]]), factor[None])
    drawn = to_free(1, mixture.draw(20000, np.random.default_rng(0)))
    np.testing.assert_allclose(drawn.mean(axis=0), [1, 0, 0, -1], atol=0.05)
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.15)


@pytest.mark.parametrize("finger", range(5))
def test_modelled_angles_there_and_back(finger):
    free = np.random.default_rng(finger).normal(size=(3, 5 if finger == 4 else 4))
    np.testing.assert_allclose(to_free(finger, from_free(finger, free)), free, atol=1e-12)


def test_what_is_usual_keeps_its_part():
    narrow = PostureMixture(0, np.zeros(1), np.full((1, 4), 50.0), np.eye(4)[None])
    both = with_usual(narrow, 0.75)
    usual = ANGLE_MEAN[0][None]
    assert both.log_density(usual)[0] == pytest.approx(np.log(0.25) - 2 * np.log(2 * np.pi))
    assert both.component(ANGLE_MEAN[0]) == 1


def test_the_shipped_prior_knows_more_of_new_objects_than_what_is_usual():
    card = json.loads(WEIGHTS.with_suffix(".json").read_text())
    grasps = builtin_grasps()
    grasps = grasps.select(np.isin(grasps.object_name, card["not trained on"]))
    gain = []
    for grasp in grasps:
        hand = skeleton_through(inverse_transform_points(grasp.object_pose, grasp.hand_joints), 0.002)
        near = HandSurroundings(
            builtin_object(grasp.object_name).signed_distance, np.array([0.0, 0, 0, 1, 0, 0, 0])
        )
        surface = surface_features(hand, lambda points, near=near: near.object_distance(points)[0])
        for finger in range(5):
            known = np.arange(5) != finger
            mixture = shipped_prior().mixture(finger, surface, hand.angles, known)
            free = to_free(finger, hand.angles[finger][None])
            usual = -0.5 * np.sum(free**2) - 0.5 * free.size * np.log(2 * np.pi)
            gain.append(float(mixture.log_density(hand.angles[finger][None])[0] - usual))
    assert len(gain) > 100
    # In nats a finger, of built-in objects that it was not trained on.
    assert np.mean(gain) > 1.0


def test_other_files_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", layers=3)
    with pytest.raises(FungraspError, match="weight_0_0"):
        FingerPrior.load(tmp_path / "other.npz")


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
