"""Force closure of contacts that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.evaluation.force_closure import closure_epsilon, closure_residual, primitive_wrenches

AXES = np.concatenate([np.eye(3), -np.eye(3)])
LENGTH = 0.05


def wrenches(outward: np.ndarray, friction: float = 0.9, shift: np.ndarray | None = None) -> np.ndarray:
    """Contacts on a ball of radius ``LENGTH``."""
    points = LENGTH * outward if shift is None else LENGTH * outward + shift
    return primitive_wrenches(points, -outward, LENGTH, friction)


def test_edges_of_a_cone():
    edges = wrenches(np.array([[0.0, 0.0, 1.0]]), friction=0.5)
    assert edges.shape == (8, 6)
    np.testing.assert_allclose(edges[:, 2], -1.0)
    np.testing.assert_allclose(np.linalg.norm(edges[:, :2], axis=1), 0.5)
    np.testing.assert_allclose(edges[:, 3:], np.cross([0, 0, 1], edges[:, :3]), atol=1e-12)


def test_two_opposite_fingers_balance_but_let_the_object_turn():
    pinch = wrenches(np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    assert closure_residual(pinch) < 1e-9
    assert closure_epsilon(pinch) == 0.0


def test_fingers_on_one_side_do_not_balance():
    """Three fingers from above: the best they can do is to press with all their normal force, 1."""
    side = np.array([[0.1, 0, 1.0], [-0.1, 0.1, 1.0], [0, -0.1, 1.0]])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    above = wrenches(side, friction=0.2)
    assert 0.9 < closure_residual(above) < 1.0
    assert closure_epsilon(above) == 0.0


def test_no_contact():
    nothing = primitive_wrenches(np.zeros((0, 3)), np.zeros((0, 3)), LENGTH)
    assert closure_residual(nothing) == 1.0 and closure_epsilon(nothing) == 0.0


def test_without_friction_a_ball_turns_freely():
    assert closure_epsilon(wrenches(AXES, friction=0.0)) == 0.0


def test_six_fingers_hold_in_all_directions():
    epsilon = closure_epsilon(wrenches(AXES))
    assert closure_residual(wrenches(AXES)) < 1e-9
    assert 0.2 < epsilon < 1.0


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 6))
def test_epsilon_is_the_weakest_direction(seed, count):
    """The support of the wrenches in any direction is at least epsilon, and in some nearly equal to it."""
    random = np.random.default_rng(seed)
    outward = random.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    some = wrenches(outward)
    epsilon = closure_epsilon(some)
    directions = random.normal(size=(2000, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    support = (directions @ some.T).max(axis=1)
    if epsilon > 0:
        assert support.min() >= epsilon - 1e-9
        assert closure_residual(some) < 1e-6


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_more_friction_is_never_worse(seed):
    random = np.random.default_rng(seed)
    outward = random.normal(size=(5, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    values = [closure_epsilon(wrenches(outward, friction)) for friction in (0.3, 0.6, 0.9)]
    assert values[0] <= values[1] + 1e-9 <= values[2] + 2e-9
    residuals = [closure_residual(wrenches(outward, friction)) for friction in (0.3, 0.6, 0.9)]
    assert residuals[0] >= residuals[1] - 1e-9 >= residuals[2] - 2e-9


def test_turning_the_whole_scene_keeps_a_cone_nearly_the_same():
    """The cones are pyramids with a free start angle, so the value moves a little."""
    turn = Rotation.from_euler("xyz", [0.3, 1.1, -0.6])
    assert closure_epsilon(wrenches(turn.apply(AXES))) == pytest.approx(
        closure_epsilon(wrenches(AXES)), rel=0.15
    )
