"""Contact forces that balance, edges of friction cones, and force closure that can be worked out by hand."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.optimization.force_closure import (
    _balance,
    closure_epsilon,
    closure_residual,
    primitive_wrenches,
)
from fungrasp.optimization.friction_cones import friction_cone_edges

FRICTION = 0.4
AXES = np.concatenate([np.eye(3), -np.eye(3)])
LENGTH = 0.05


@numba.njit
def _balance_each(lever, inward, used, friction, iterations, result):
    """``_balance`` is only called by compiled loops."""
    force = np.empty((lever.shape[1], 3))
    for i in range(len(lever)):
        which = np.flatnonzero(used[i])
        if len(which):
            _balance(lever[i][which], inward[i][which], len(which), friction, iterations, force)
            for c in range(len(which)):
                result[i, which[c]] = force[c]


def balanced_forces(
    lever: np.ndarray, inward: np.ndarray, used: np.ndarray, friction: float, iterations: int = 40
) -> np.ndarray:
    """Contact forces of N grasps, shape [N, C, 3]; zero where a contact may not press, shape [N, C] bool."""
    result = np.zeros(lever.shape)
    _balance_each(*(np.ascontiguousarray(x) for x in (lever, inward, used)), friction, iterations, result)
    return result


def unbalanced(lever: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Norm of the sum of forces and torques, shape [N]."""
    return np.linalg.norm(
        np.concatenate([force.sum(axis=1), np.cross(lever, force).sum(axis=1)], axis=1), axis=1
    )


def in_a_ring(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Contacts on a disc of radius 1 and their inward normals, shape [1, count, 3]."""
    angles = 2 * np.pi * np.arange(count) / count
    points = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=-1)[None]
    return points, -points


@pytest.mark.parametrize(("count", "friction"), [(2, 0.0), (3, FRICTION), (5, FRICTION)])
def test_contacts_all_around_balance(count: int, friction: float):
    lever, inward = in_a_ring(count)
    force = balanced_forces(lever, inward, np.ones((1, count), dtype=bool), friction)
    assert unbalanced(lever, force)[0] < 0.01


def test_contacts_on_one_side_do_not():
    lever = np.array([[[0.0, -0.5, -1.0], [0.0, 0.5, -1.0]]])
    inward = np.tile([0.0, 0.0, 1.0], (1, 2, 1))
    force = balanced_forces(lever, inward, np.ones((1, 2), dtype=bool), FRICTION)
    np.testing.assert_allclose(force.sum(axis=1)[0, 2], 1.0, rtol=1e-9)


def test_friction_balances_what_normals_alone_cannot():
    """Two contacts on slopes of 15 degrees: held if the friction exceeds their tangent, 0.27."""
    slope = np.radians(15.0)
    lever = np.array([[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]])
    inward = np.array([[[-np.cos(slope), 0.0, np.sin(slope)], [np.cos(slope), 0.0, np.sin(slope)]]])
    used = np.ones((1, 2), dtype=bool)
    assert unbalanced(lever, balanced_forces(lever, inward, used, 0.4, iterations=300))[0] < 0.02
    assert unbalanced(lever, balanced_forces(lever, inward, used, 0.15, iterations=300))[0] > 0.08
    np.testing.assert_allclose(
        unbalanced(lever, balanced_forces(lever, inward, used, 0.0)), np.sin(slope), rtol=1e-6
    )


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 8), friction=st.floats(0.0, 1.0))
def test_forces_stay_in_their_cones_and_their_normal_parts_sum_to_one(seed: int, count: int, friction: float):
    random = np.random.default_rng(seed)
    lever, inward = random.normal(size=(2, 6, count, 3))
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    used = random.random((6, count)) < 0.7
    force = balanced_forces(lever, inward, used, friction)
    pressure = np.sum(force * inward, axis=-1)
    sideways = np.linalg.norm(force - pressure[..., None] * inward, axis=-1)
    assert np.all(pressure >= -1e-9)
    assert np.all(sideways <= friction * pressure + 1e-9)
    assert np.all(force[~used] == 0)
    np.testing.assert_allclose(pressure.sum(axis=1), used.any(axis=1), atol=1e-6)


@pytest.mark.parametrize("count", [6, 8])
@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
def test_friction_cone_edges_lie_on_the_cone(axis: list[float], count: int):
    inward = np.array(axis)
    edges = friction_cone_edges(inward, FRICTION, count)
    assert edges.shape == (count, 3)
    np.testing.assert_allclose(edges @ inward, 1.0)
    np.testing.assert_allclose(np.linalg.norm(edges - inward, axis=-1), FRICTION)
    np.testing.assert_allclose(edges.mean(axis=0), inward, atol=1e-12)


def wrenches(outward: np.ndarray, friction: float = 0.9, shift: np.ndarray | None = None) -> np.ndarray:
    """Contacts on a ball of radius ``LENGTH``."""
    points = LENGTH * outward if shift is None else LENGTH * outward + shift
    return primitive_wrenches(points, -outward, LENGTH, friction)


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
    nothing = primitive_wrenches(np.zeros((0, 3)), np.zeros((0, 3)), LENGTH, FRICTION)
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
