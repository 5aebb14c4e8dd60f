"""Contact forces that balance, and the edges of friction cones."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import reference_terms
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.optimization.closure_term import _balance
from fungrasp.optimization.friction_cones import circle, friction_cone_edges

FRICTION = 0.4
EDGES = 6


def balanced_forces(
    lever: np.ndarray, inward: np.ndarray, used: np.ndarray, friction: float, iterations: int = 40
) -> np.ndarray:
    """Contact forces of N grasps, shape [N, C, 3]; zero where a contact may not press, shape [N, C] bool."""
    result = np.zeros(lever.shape)
    _balance_each(*(np.ascontiguousarray(x) for x in (lever, inward, used)), friction, iterations, result)
    return result


@numba.njit
def _balance_each(lever, inward, used, friction, iterations, result):
    around, most = circle(EDGES), lever.shape[1]
    edges, matrix = np.empty((most * EDGES, 3)), np.empty((7, most * EDGES))
    force = np.empty((most, 3))
    for i in range(len(lever)):
        which = np.flatnonzero(used[i])
        if len(which):
            _balance(
                lever[i][which],
                inward[i][which],
                len(which),
                friction,
                around,
                iterations,
                edges,
                matrix,
                force,
            )
            for c in range(len(which)):
                result[i, which[c]] = force[c]


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


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("friction", [0.0, FRICTION])
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


def test_turning_the_scene_turns_the_forces():
    """Only the directions of the cones' edges depend on the frame: without friction nothing does."""
    random = np.random.default_rng(0)
    lever, inward = random.normal(size=(2, 1, 5, 3))
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    used, turn = np.ones((1, 5), dtype=bool), Rotation.random(rng=1).as_matrix().T
    force = balanced_forces(lever, inward, used, 0.0)
    np.testing.assert_allclose(
        balanced_forces(lever @ turn, inward @ turn, used, 0.0), force @ turn, atol=1e-9
    )


def test_batch_is_each_by_itself():
    random = np.random.default_rng(0)
    lever, inward = random.normal(size=(2, 4, 6, 3))
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    used = random.random((4, 6)) < 0.6
    together = balanced_forces(lever, inward, used, FRICTION)
    for i in range(4):
        alone = balanced_forces(lever[i : i + 1], inward[i : i + 1], used[i : i + 1], FRICTION)
        np.testing.assert_allclose(together[i], alone[0], atol=1e-12)


@pytest.mark.parametrize("count", [6, 8])
@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
def test_friction_cone_edges_lie_on_the_cone(axis: list[float], count: int):
    inward = np.array(axis)
    edges = friction_cone_edges(inward, FRICTION, count)
    assert edges.shape == (count, 3)
    np.testing.assert_allclose(edges @ inward, 1.0)
    np.testing.assert_allclose(np.linalg.norm(edges - inward, axis=-1), FRICTION)
    np.testing.assert_allclose(edges.mean(axis=0), inward, atol=1e-12)


def test_forces_and_edges_are_those_of_numpy():
    random = np.random.default_rng(0)
    lever, inward = random.normal(size=(2, 4, 6, 3))
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    used = random.random((4, 6)) < 0.6
    np.testing.assert_allclose(
        balanced_forces(lever, inward, used, FRICTION),
        reference_terms.balanced_forces(lever, inward, used, FRICTION),
        atol=1e-9,
    )
    np.testing.assert_allclose(
        friction_cone_edges(inward, FRICTION, 8),
        reference_terms.friction_cone_edges(inward, FRICTION, 8),
        atol=1e-12,
    )
