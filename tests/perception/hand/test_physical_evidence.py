"""Fingers that are inside each other are pushed apart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fungrasp.grasps import load_human_grasps
from fungrasp.perception.hand.fit import skeleton_through
from fungrasp.perception.hand.physical_evidence import finger_overlap, nearest_between, overlap_evidence
from fungrasp.perception.hand.skeleton import ANGLE_MEAN, SIZE, Skeleton


def crossed() -> Skeleton:
    """A hand whose index finger leans into the middle one."""
    hand = Skeleton.usual(np.array([0.0, 0.0, 0.5]), np.eye(3))
    angles = ANGLE_MEAN.copy()
    angles[:2, :, 1] = ANGLE_MEAN[0, :, 1]
    angles[0, 0, 0] = np.radians(-28)
    return dataclasses.replace(hand, angles=angles)


def test_lines_are_nearest_where_they_are():
    a, b = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0]]), np.array([[1.0, 0, 0]] * 3)
    c = np.array([[0.5, 1, 1], [2.0, 1, 0], [0.2, 0.1, 0]])
    d = np.array([[0.5, -1, 1], [3.0, 1, 0], [0.7, 0.1, 0]])
    s, t = nearest_between(a, b, c, d)
    gap = np.linalg.norm(a + s[:, None] * (b - a) - c - t[:, None] * (d - c), axis=1)
    np.testing.assert_allclose(gap, [1, np.sqrt(2), 0.1], atol=1e-9)
    np.testing.assert_allclose([s[0], t[0]], 0.5)


@pytest.mark.parametrize("seed", range(5))
def test_nearest_of_random_lines(seed):
    ends = np.random.default_rng(seed).normal(size=(4, 6, 3))
    s, t = nearest_between(*ends)
    a, b, c, d = ends
    gap = np.linalg.norm(a + s[:, None] * (b - a) - c - t[:, None] * (d - c), axis=1)
    parts = np.linspace(0, 1, 101)
    one = a[:, None] + parts[:, None] * (b - a)[:, None]
    other = c[:, None] + parts[:, None] * (d - c)[:, None]
    brute = np.linalg.norm(one[:, :, None] - other[:, None], axis=-1).min(axis=(1, 2))
    assert (gap < brute + 0.02).all()


def test_derivatives_of_overlaps():
    hand = crossed()

    def residuals(moved):
        return overlap_evidence(moved, *moved.joints_and_derivatives(), 0.001)

    here = residuals(hand)
    assert len(here.residual) and (here.residual < 0).all()
    scale = np.abs(here.jacobian[:, 37:]).max()
    for parameter in (4, 37, 38, 41, 46, 47):
        step = np.zeros(SIZE)
        step[parameter] = 1e-6
        slope = (residuals(hand.moved(step)).residual - here.residual) / 1e-6
        # That the capsules taper is left out.
        np.testing.assert_allclose(slope, here.jacobian[:, parameter], atol=0.15 * scale)


def test_people_keep_their_fingers_apart():
    for row in (3, 40, 80):
        hand = skeleton_through(load_human_grasps("builtin").hand_joints[row], 0.003)
        found = overlap_evidence(hand, *hand.joints_and_derivatives(), 0.001)
        assert np.abs(found.residual).max(initial=0.0) < 4


def test_a_finger_inside_another_costs():
    hand = crossed()
    joints = hand.joints()
    middle = 0.5 * (joints[6] + joints[7])
    points = np.array([[middle], [middle + np.array([0, 0, 0.1])]])
    deep = finger_overlap(points, np.array([0.008]), hand, 0)
    assert deep[0, 0] > 0.01 and deep[1, 0] == 0
    assert finger_overlap(points, np.array([0.008]), hand, 1)[0, 0] < deep[0, 0]
