"""Fingers that are inside each other are pushed apart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fungrasp.perception.hand.physical_evidence import nearest_between, overlap_evidence
from fungrasp.perception.hand.skeleton import ANGLE_MEAN, SIZE, Skeleton


def crossed() -> Skeleton:
    """A hand whose index finger leans into the middle one."""
    hand = Skeleton.usual(np.array([0.0, 0.0, 0.5]), np.eye(3))
    angles = ANGLE_MEAN.copy()
    angles[:2, :, 1] = ANGLE_MEAN[0, :, 1]
    angles[0, 0, 0] = np.radians(-28)
    return dataclasses.replace(hand, angles=angles)


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
        return overlap_evidence(moved, *moved.joints_and_derivatives())

    here = residuals(hand)
    assert len(here.residual) and (here.residual < 0).all()
    scale = np.abs(here.jacobian[:, 37:]).max()
    for parameter in (4, 37, 38, 41, 46, 47):
        step = np.zeros(SIZE)
        step[parameter] = 1e-6
        slope = (residuals(hand.moved(step)).residual - here.residual) / 1e-6
        # That the capsules taper is left out.
        np.testing.assert_allclose(slope, here.jacobian[:, parameter], atol=0.15 * scale)
