"""The metric hand: accuracy on made scenes, left hands, holes in depth, contact and non-penetration."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hand_scenes import CAMERA, hand_scene

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid
from fungrasp.grasps import load_human_grasps
from fungrasp.perception import HandEstimate
from fungrasp.perception.hand.fit import fit_hand, refine_hand
from fungrasp.perception.hand.fit_problem import image_agreement
from fungrasp.perception.hand.physical_evidence import HandSurroundings
from fungrasp.perception.hand.skeleton import HandEvidence

ROWS = range(0, 24, 4)


@pytest.fixture(scope="module")
def scenes():
    rng = np.random.default_rng(3)
    return [(scene := hand_scene(row, rng), scene.detected(rng)) for row in ROWS]


def errors(hand, joints):
    return np.linalg.norm(hand.joints_camera - joints, axis=1)


def test_joints_within_the_target_on_noisy_landmarks(scenes):
    found = np.array([errors(fit_hand(detected, scene.capture), scene.joints) for scene, detected in scenes])
    assert found.mean() < 0.012
    assert found.mean(axis=1).max() < 0.03


def test_confidence_falls_where_the_covariance_grows(scenes):
    scene, detected = scenes[0]
    hand = fit_hand(detected, scene.capture)
    order = np.argsort(np.trace(hand.covariance, axis1=1, axis2=2))
    assert (np.diff(hand.confidence[order]) <= 1e-9).all()
    assert np.linalg.eigvalsh(hand.covariance).min() > 0
    vague = dataclasses.replace(
        detected, pixels=detected.pixels + np.random.default_rng(0).normal(size=(21, 2)) * 25
    )
    assert fit_hand(vague, scene.capture).score < hand.score


def test_agreement_counts_landmarks_and_skin_that_is_seen_through():
    none = np.zeros((4, 1))
    landmarks = HandEvidence(np.zeros(4), none, outlier=4.0, group=2)
    half = HandEvidence(np.array([0.0, 1.0, -9.0, -9.0]), none, outlier=np.full(4, 3.0))
    assert image_agreement(landmarks, half) == 0.5
    assert image_agreement(landmarks, HandEvidence(np.zeros(0), np.zeros((0, 1)), outlier=np.zeros(0))) == 0.0
    assert image_agreement(HandEvidence(np.full(4, 99.0), none, outlier=4.0, group=2), half) < 1e-3


@pytest.fixture(scope="module")
def held():
    row = int(np.flatnonzero(load_human_grasps("builtin").object_name == "can")[0])
    scene = hand_scene(row, np.random.default_rng(6))
    return scene, SignedDistanceGrid.from_mesh(scene.model.vertices, scene.model.faces, 0.004)


def depth_inside(scene, grid, joints):
    local = inverse_transform_points(scene.pose_camera_object, joints)
    return -SignedDistanceBank([grid]).query(np.zeros(1, int), local[None])[0].min()


def certain(scene, joints, deviation=0.01):
    covariance = np.tile(np.eye(3) * deviation**2, (21, 1, 1))
    return HandEstimate(joints, CAMERA.project(joints), np.ones(21), covariance, "right", 0.9)


def test_refined_hand_leaves_the_object(held):
    scene, grid = held
    touching = scene.joints[[4, 8, 12, 16, 20]]
    distance, gradient = HandSurroundings(grid, scene.pose_camera_object).object_distance(touching)
    nearest = distance.argmin()
    pushed = certain(scene, scene.joints - (0.012 + distance[nearest]) * gradient[nearest])
    refined = refine_hand(pushed, HandSurroundings(grid, scene.pose_camera_object, scene.table))
    assert depth_inside(scene, grid, pushed.joints_camera) > 0.004
    assert depth_inside(scene, grid, refined.joints_camera) < 0.002
    assert errors(refined, scene.joints).mean() < errors(pushed, scene.joints).mean()


def test_refining_a_left_hand_is_refining_its_mirror_image(held):
    scene, grid = held
    mirror = np.array([-1.0, 1.0, 1.0])
    hand = certain(scene, scene.joints + np.array([0.004, 0.003, 0.006]))
    right = refine_hand(hand, HandSurroundings(grid, scene.pose_camera_object))
    flipped = SignedDistanceGrid(
        np.array([-grid.origin[0] - grid.spacing * (grid.values.shape[0] - 1), *grid.origin[1:]]),
        grid.spacing,
        np.ascontiguousarray(grid.values[::-1]),
    )
    pose = scene.pose_camera_object * [-1, 1, 1, 1, 1, -1, -1]
    left = refine_hand(
        dataclasses.replace(hand, joints_camera=hand.joints_camera * mirror, side="left"),
        HandSurroundings(flipped, pose),
    )
    np.testing.assert_allclose(left.joints_camera, right.joints_camera * mirror, atol=1e-5)
