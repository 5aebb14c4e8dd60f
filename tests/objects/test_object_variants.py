"""Objects of another size, or whose mass lies elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from task_scenes import plain

from fungrasp.geometry import SignedDistanceBank
from fungrasp.objects import builtin_object, scaled_name, scaled_object, shifted_mass, with_sizes


def test_another_size_has_all_lengths_larger_and_the_same_mass():
    mug = builtin_object("mug")
    large = scaled_object(mug, 1.01)
    assert large.name == "mug x1.01" and large.mass == mug.mass
    np.testing.assert_allclose(large.size, 1.01 * mug.size)
    np.testing.assert_allclose(large.center_of_mass, 1.01 * mug.center_of_mass, atol=1e-9)
    np.testing.assert_allclose(large.inertia, 1.01**2 * mug.inertia, rtol=1e-6, atol=1e-12)
    assert len(large.pieces) == len(mug.pieces)
    np.testing.assert_allclose(large.pieces[0].vertices, 1.01 * mug.pieces[0].vertices)


def test_distances_of_another_size_are_scaled_along():
    mug = builtin_object("mug")
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (1, 20, 3))
    bank = SignedDistanceBank([mug.signed_distance, scaled_object(mug, 1.2).signed_distance])
    own, _ = bank.query(np.array([0]), points)
    other, _ = bank.query(np.array([1]), 1.2 * points)
    np.testing.assert_allclose(other, 1.2 * own, atol=1e-6)


def test_sizes_have_names_of_their_own_and_the_objects_keep_theirs():
    objects = {name: builtin_object(name) for name in ("mug", "can")}
    sizes = with_sizes(objects, (0.99, 1.0, 1.01))
    assert list(sizes) == ["mug", "can", "mug x0.99", "can x0.99", "mug x1.01", "can x1.01"]
    assert sizes["can"] is objects["can"] and scaled_name("can", 1.0) == "can"
    assert list(with_sizes(objects, (1.0,))) == ["mug", "can"]


def test_without_a_shift_the_mass_is_where_it_was():
    box = plain("box", (0.1, 0.2, 0.3))
    center, inertia = shifted_mass(
        box.center_of_mass[None], box.inertia[None], np.array([box.mass]), box.size[None], np.zeros((1, 3))
    )
    np.testing.assert_array_equal(center[0], box.center_of_mass)
    np.testing.assert_array_equal(inertia[0], box.inertia)


def test_a_shifted_mass_is_that_of_a_box_with_a_weight_at_its_wall():
    """15 % along one axis: 30 % of the mass sits in the middle of the wall there."""
    box, mass = plain("box", (0.1, 0.2, 0.3), 1.0), 1.0
    shift = np.array([[0.0, 0.15, 0.0]])
    center, inertia = shifted_mass(
        box.center_of_mass[None], box.inertia[None], np.array([mass]), box.size[None], shift
    )
    np.testing.assert_allclose(center[0], [0.0, 0.03, 0.0], atol=1e-12)
    # 0.7 kg of box 3 cm from the new center, 0.3 kg 7 cm from it on the other side.
    beside = 0.7 * 0.03**2 + 0.3 * 0.07**2
    np.testing.assert_allclose(inertia[0], 0.7 * box.inertia + beside * np.diag([1.0, 0.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize("name", ["tennis_ball", "mug", "drill", "scissors"])
def test_a_shifted_mass_is_always_possible(name):
    """Principal moments obey the triangle inequality: no part of the mass is negative."""
    thing, count = builtin_object(name), 200
    shift = np.random.default_rng(0).uniform(-0.15, 0.15, (count, 3))
    _, inertia = shifted_mass(
        np.tile(thing.center_of_mass, (count, 1)),
        np.tile(thing.inertia, (count, 1, 1)),
        np.full(count, thing.mass),
        np.tile(thing.size, (count, 1)),
        shift,
    )
    moments = np.linalg.eigvalsh(inertia)
    assert (moments[:, 0] > 0).all() and (moments[:, 0] + moments[:, 1] >= moments[:, 2] * (1 - 1e-9)).all()
