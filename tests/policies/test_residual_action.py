"""Residual actions, on NumPy and on torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measured_states import poses

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, invert, rotation_vector
from fungrasp.policies.residual_action import ResidualSettings, add_residual, smoothed

SETTINGS = ResidualSettings(position=0.03, rotation=0.2, fingers=0.3, smoothing=0.75)


def _torch(values: Any) -> Any:
    return pytest.importorskip("torch").tensor(np.asarray(values), dtype=pytest.importorskip("torch").float64)


@pytest.fixture(params=[np.asarray, _torch], ids=["numpy", "torch"])
def array(request) -> Callable[[Any], Any]:
    return request.param


def test_actions_are_cut_and_smoothed(array):
    result = smoothed(array([[0.4, 7.0, -2.0]]), array([[0.0, 1.0, 0.2]]), SETTINGS)
    assert type(result) is type(array([0.0]))
    np.testing.assert_allclose(np.asarray(result), [[0.1, 1.0, -0.1]])


def test_a_residual_is_along_the_axes_of_the_palm(array):
    """A palm whose x axis is the world's y axis, moved along and turned about its x axis."""
    half = np.sqrt(0.5)
    goal, fingers = [[1.0, 2.0, 3.0, half, 0, 0, half]], [[0.5, 0.5]]
    action = [[1.0, 0, 0, 0.5, 0, 0, -1.0, 0.5]]
    pose, targets = add_residual(array(goal), array(fingers), array(action), SETTINGS)
    np.testing.assert_allclose(np.asarray(pose)[0, :3], [1.0, 2.03, 3.0], atol=1e-12)
    turn = rotation_vector(compose(invert(np.array(goal)), np.asarray(pose))[:, 3:])
    np.testing.assert_allclose(turn, [[0.1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(np.asarray(targets), [[0.2, 0.65]])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_action_changes_nothing_and_no_action_goes_too_far(seed):
    rng = np.random.default_rng(seed)
    goal, fingers = poses(rng, 4), rng.normal(size=(4, 16))
    pose, targets = add_residual(goal, fingers, np.zeros((4, 22)), SETTINGS)
    np.testing.assert_array_equal(pose, goal)
    np.testing.assert_array_equal(targets, fingers)
    pose, targets = add_residual(goal, fingers, rng.uniform(-1, 1, (4, 22)), SETTINGS)
    assert (np.abs(targets - fingers) <= SETTINGS.fingers).all()
    shift = compose(invert(goal), pose)
    assert (np.abs(shift[:, :3]) <= SETTINGS.position + 1e-9).all()
    assert (np.abs(rotation_vector(shift[:, 3:])) <= SETTINGS.rotation + 1e-9).all()


def test_actions_without_a_planned_motion_are_not_shrunk():
    """A hand that takes half the steps arrives late."""
    guided = replace(SETTINGS, base="guided")
    assert guided.shrunk(0.5) == guided


def test_shrunk_actions_mean_less():
    half = SETTINGS.shrunk(0.5)
    assert (half.position, half.rotation, half.fingers, half.smoothing) == (0.015, 0.1, 0.15, 0.75)
    for factor in (0.0, 1.1, float("nan")):
        with pytest.raises(FungraspError, match="above 0 and at most 1"):
            SETTINGS.shrunk(factor)
