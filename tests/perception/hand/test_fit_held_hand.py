"""The hand that holds a known object: capsules, points, the search of fingers, and which guess wins."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hand_scenes import CAMERA, hand_scene

from fungrasp.geometry.signed_distance import SignedDistanceGrid
from fungrasp.grasps import load_human_grasps
from fungrasp.perception import Capture
from fungrasp.perception.hand import fit
from fungrasp.perception.hand.finger_search import search_fingers
from fungrasp.perception.hand.fit import fit_held_hand, skeleton_through
from fungrasp.perception.hand.hand_capsules import HAND_CAPSULES, explained_part, nearest_capsules
from fungrasp.perception.hand.hand_measurements import hand_view
from fungrasp.perception.hand.image_evidence import point_evidence
from fungrasp.perception.hand.physical_evidence import HandSurroundings
from fungrasp.perception.hand.skeleton import SIZE


@pytest.fixture(scope="module")
def held():
    row = int(np.flatnonzero(load_human_grasps("builtin").object_name == "can")[0])
    scene = hand_scene(row, np.random.default_rng(6))
    grid = SignedDistanceGrid.from_mesh(scene.model.vertices, scene.model.faces, 0.004)
    return scene, HandSurroundings(grid, scene.pose_camera_object, scene.table)


def error(joints, truth):
    return np.linalg.norm(joints - truth, axis=1).mean()


def test_distance_of_a_point_from_a_capsule():
    first, last = np.array([[0.0, 0, 1]]), np.array([[0.1, 0, 1]])
    points = np.array([[0.05, 0, 0.95], [-0.03, 0, 0.96], [0.05, 0, 1.05]])
    which, distance, along, normal = nearest_capsules(points, first, last, np.array([[0.01, 0.02]]))
    # Half-way the capsule is 15 mm thick; the third point is on the side that the camera can't see.
    np.testing.assert_allclose(distance, [0.035, 0.04, 0.055], atol=1e-9)
    np.testing.assert_allclose(along, [0.5, 0.0, 0.5])
    np.testing.assert_allclose(normal[0], [0, 0, -1])
    assert not which.any()


def test_derivatives_of_points_on_the_skin(held):
    scene, surroundings = held
    hand = skeleton_through(scene.joints, 0.003)
    points = hand_view(scene.capture, surroundings, [scene.joints]).points

    def residuals(moved):
        joints, jacobian = moved.joints_and_derivatives()
        return point_evidence(moved, joints, jacobian, points, 1.0)

    here = residuals(hand)
    for parameter in (0, 4, 9, 30, 45, 80):
        step = np.zeros(SIZE)
        step[parameter] = 1e-6
        there = residuals(hand.moved(step))
        slope = (there.residual - here.residual) / 1e-6
        expected = here.jacobian[:, parameter]
        # The taper of the capsules is left out, and that the arm turns when the wrist moves.
        assert (np.abs(slope - expected) < 0.1 * np.abs(expected).max()).mean() > 0.8


def test_points_of_the_hand_are_neither_object_nor_table(held):
    scene, surroundings = held
    points = hand_view(scene.capture, surroundings, [scene.joints]).points
    assert len(points) > 100
    assert np.abs(surroundings.object_distance(points)[0]).min() > 0.004
    assert surroundings.table_distance(points)[0].min() > 0.004
    assert explained_part(skeleton_through(scene.joints, 0.003), points) > 0.9
    aside = skeleton_through(scene.joints + np.array([0.05, 0, 0]), 0.003)
    assert explained_part(aside, points) < 0.7


def test_skin_color_leaves_other_things_out(held):
    scene, surroundings = held
    color = np.full_like(scene.capture.color, (200, 150, 120))
    distance = nearest_capsules(
        scene.capture.points().reshape(-1, 3), *HAND_CAPSULES.ends(scene.joints), HAND_CAPSULES.radius
    )[1]
    far = np.abs(distance).reshape(color.shape[:2]) > 0.012
    color[far | ~scene.capture.measured] = (40, 90, 200)
    whole = hand_view(scene.capture, surroundings, [scene.joints])
    skin = hand_view(Capture(color, scene.capture.depth, CAMERA), surroundings, [scene.joints])
    pixels = np.rint(CAMERA.project(skin.points)).astype(int)
    assert (color[pixels[:, 1], pixels[:, 0], 0] == 200).all()
    assert len(skin.points) > 0.3 * len(whole.points)


def test_the_search_brings_a_finger_back(held):
    scene, surroundings = held
    hand = skeleton_through(scene.joints, 0.003)
    angles = hand.angles.copy()
    angles[1, :, 1] -= np.radians([70, 30, 10])
    lost = dataclasses.replace(hand, angles=angles)
    view = hand_view(scene.capture, surroundings, [scene.joints])
    found = search_fingers(lost, view, CAMERA.project(scene.joints), None, np.random.default_rng(0))
    tip = 8
    assert np.linalg.norm(lost.joints()[tip] - scene.joints[tip]) > 0.04
    assert np.linalg.norm(found.joints()[tip] - scene.joints[tip]) < 0.02


def test_landmarks_that_are_wrong_lower_the_score(held):
    scene, surroundings = held
    right = scene.detected(np.random.default_rng(7))
    wrong = dataclasses.replace(
        right, pixels=right.pixels[::-1] + np.array([20, 10]), shape_camera=right.shape_camera[::-1]
    )
    hand, other = (fit_held_hand(one, scene.capture, surroundings, scene.joints) for one in (right, wrong))
    assert error(hand.joints_camera, scene.joints) < 0.012 and hand.score > other.score
    assert surroundings.object_distance(hand.joints_camera)[0].min() > -0.004


def test_the_side_that_fits_the_depth_wins_if_in_doubt(held):
    scene, surroundings = held
    detected = dataclasses.replace(scene.detected(np.random.default_rng(7)), side="left", side_score=0.6)
    hand = fit_held_hand(detected, scene.capture, surroundings, scene.joints)
    assert hand.side == "right" and error(hand.joints_camera, scene.joints) < 0.015
    assert fit_held_hand(detected, scene.capture, surroundings, scene.joints, side="left").side == "left"


def test_the_seed_decides_which_postures_are_tried(held, monkeypatch):
    scene, surroundings = held
    drawn = []

    def search(skeleton, view, landmarks, spread, rng):
        drawn.append(rng.random())
        return skeleton

    monkeypatch.setattr(fit, "search_fingers", search)
    detected = scene.detected(np.random.default_rng(7))
    fit_held_hand(detected, scene.capture, surroundings, scene.joints, seed=3)
    assert set(drawn) == {np.random.default_rng(3).random()}
