"""Each term of the reward against values computed by hand, on NumPy and on torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.task import reward
from fungrasp.task.reward import RewardWeights

Library = Callable[[Any], Any]


def _torch(values: Any) -> Any:
    torch = pytest.importorskip("torch")
    array = np.asarray(values)
    return torch.tensor(array, dtype=torch.bool if array.dtype == bool else torch.float64)


@pytest.fixture(params=[np.asarray, _torch], ids=["numpy", "torch"])
def array(request) -> Library:
    return request.param


def check(result: Any, library: Library, expected: list[float]) -> None:
    """The right values, of the library and precision of the inputs."""
    assert type(result) is type(library([0.0]))
    assert result.dtype == library([0.0]).dtype
    np.testing.assert_allclose(np.asarray(result), expected, atol=1e-12)


def test_position_counts_squared_distance_in_units_up_to_one(array):
    keypoints = [[[0.1, 0, 0], [0, 0.03, 0.04]], [[0.02, 0.01, 0], [0, 0, 0]], [[9, 9, 9], [9, 9, 9]]]
    targets = [[[0.1, 0, 0], [0, 0, 0]], [[0, 0.01, 0], [0, 0, 0.03]], [[0, 0, 0], [0, 0, 0]]]
    # World 0: 0 and (5 cm)^2 = 1 unit, weighted 1 and 3. World 1: (2/5)^2 and (3/5)^2. World 2: both far.
    result = reward.position_reward(array(keypoints), array(targets), array([1.0, 3.0]))
    check(result, array, [-3 / 4, -(0.16 + 3 * 0.36) / 4, -1.0])
    wider = reward.position_reward(array(keypoints), array(targets), array([1.0, 3.0]), scale=0.1)
    check(wider, array, [-3 / 4 * 0.25, -(0.04 + 3 * 0.09) / 4, -1.0])


def test_approach_is_the_mean_distance_up_to_where_episodes_begin(array):
    keypoints = [[[0.3, 0, 0], [0, 0.03, 0.04]], [[0, 0, 0], [0, 0, 0]], [[9, 9, 9], [9, 9, 9]]]
    # World 0: 0.15 and 0.05 m of 0.5 m; world 1 is there; world 2 is beyond.
    targets = [[[0.15, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 0]]]
    check(reward.approach_reward(array(keypoints), array(targets), 0.5), array, [-0.2, 0.0, -1.0])


def test_contact_weight_is_the_ratio_of_squares_over_the_links_that_should_touch(array):
    targets = np.zeros((4, 3, 3))
    targets[:, :, 0] = [0.1, 0.2, 0.5]
    keypoints = targets.copy()
    keypoints[1, :2] = [[0, 0.1, 0], [0, 0, 0.1]]
    keypoints[2] *= 3.0
    keypoints[3] *= 3.0
    contacts = np.array([[True, True, False]] * 3 + [[False] * 3])
    result = reward.dynamic_contact_weight(array(keypoints), array(targets), array(contacts))
    check(result, array, [1.0, (0.01 + 0.01) / (0.01 + 0.04), 2.0, 1.0])


def test_contact_pays_target_links_and_their_force_up_to_the_cap(array):
    targets = np.array([[True, True, False, False]] * 4 + [[False] * 4])
    contacts = np.array([[True, False, True, True], [True, True, False, False]] + [[True] * 4] * 3)
    forces = [
        [1.0, 0.0, 9.0, 9.0],
        [100.0, 100.0, 0, 0],
        [4.905, 0.0, 7.0, 7.0],
        [4.0, 5.81, 0, 0],
        [9.0] * 4,
    ]
    mass = [0.1, 0.1, 0.2, 0.4, 0.2]
    given = array(contacts), array(targets), array(forces), array(mass), array(np.ones((5, 4)))
    result = reward.contact_reward(*given)
    # The caps are 4.905, 4.905, 9.81, 19.62 and 9.81 N.
    check(result, array, [1 / 2 + 1 / 4.905, 1 + 1, 1 + 1 / 2, 1 + 1 / 2, 0.0])
    lighter = reward.contact_reward(*given, cap=10.0)
    check(lighter, array, [1 / 2 + 0.5 / 4.905, 1 + 1, 1 + 1 / 4, 1 + 1 / 4, 0.0])


def test_contacts_count_by_how_close_they_are_to_their_places(array):
    targets = np.zeros((4, 2, 3))
    keypoints = targets.copy()
    keypoints[1, 0] = [0.0, 0.012, 0.016]
    keypoints[2, 0] = [0.04, 0.0, 0.0]
    keypoints[3] = 9.0
    closeness = reward.closeness(array(keypoints), array(targets))
    check(closeness, array, [[1.0, 1.0], [0.5, 1.0], [0.0, 1.0], [0.0, 0.0]])
    both = array(np.ones((4, 2), dtype=bool))
    check(reward.shown_share(both, both, closeness), array, [1.0, 0.75, 0.5, 0.0])
    forces, mass = array(np.tile([4.905, 0.0], (4, 1))), array([0.2] * 4)
    check(reward.contact_reward(both, both, forces, mass, closeness), array, [1.5, 1.0, 0.5, 0.0])


def test_safety_sums_undesired_forces_and_is_bounded(array):
    table = [[0.0, 0.0], [2.0, -1.0], [1e6, 1e6]]
    result = reward.safety_reward(array(table), array([0.0, 2.0, 0.0]))
    check(result, array, [0.0, -np.tanh(0.5), -1.0])
    check(reward.safety_reward(array([[1.0]]), array([0.0]), unit=2.0), array, [-np.tanh(0.5)])


def test_posture_is_the_mean_cosine_minus_one(array):
    targets = np.zeros((3, 2, 2, 3))
    targets[..., 2] = 0.04
    directions = targets.copy()
    directions[1, 0] = [[0.02, 0, 0.02], [0.07, 0, 0]]
    directions[1, 1] = [[0, 0, -3.0], [0, 0, 1.0]]
    # A link of the last world is padding.
    directions[2] = -targets[2]
    directions[2, 1, 1] = 0.0
    targets[2, 1, 1] = 0.0
    result = reward.posture_reward(array(directions), array(targets))
    check(result, array, [0.0, (np.sqrt(0.5) + 0 - 1 + 1) / 4 - 1, -2.0])


def test_a_hand_without_directions_has_no_posture_to_be_paid_for(array):
    nothing = array(np.zeros((1, 1, 2, 3)))
    check(reward.posture_reward(nothing, nothing), array, [0.0])


def test_lift_counts_from_the_table_to_the_goal(array):
    result = reward.lift_reward(array([-0.02, 0.0, 0.05, 0.1, 0.3]), 0.1)
    check(result, array, [0.0, 0.0, 0.5, 1.0, 1.0])


def test_stability_counts_slip_and_spin(array):
    slip = [[0.0, 0, 0], [0.03, 0.04, 0], [0, 0, 0], [9e3, 0, 0]]
    spin = [[0.0, 0, 0], [0, 0, 0], [0, -1.0, 0], [9e3, 0, 0]]
    result = reward.stability_reward(array(slip), array(spin))
    check(result, array, [0.0, -np.tanh(0.5) / 2, -np.tanh(0.5) / 2, -1.0])
    finer = reward.stability_reward(array(slip), array(spin), velocity_unit=0.05, spin_unit=1.0)
    check(finer, array, [0.0, -np.tanh(1.0) / 2, -np.tanh(1.0) / 2, -1.0])


def test_action_costs_size_and_change(array):
    action, previous = [[0.0, 0], [0.5, -1.0], [1.0, 1.0]], [[0.0, 0], [0.5, 0.0], [-1.0, -1.0]]
    result = reward.action_reward(array(action), array(previous))
    check(result, array, [0.0, -(1.25 / 2 + 1.0 / 2), -5.0])


def test_total_is_the_weighted_sum(array):
    weights = RewardWeights(position=0.5, lift=2.0, drop=-3.0)
    terms = {"position": array([-1.0, 0.0]), "lift": array([0.5, 1.0]), "drop": array([0.0, 1.0])}
    check(reward.total(terms, weights), array, [0.5, -1.0])
    check(reward.total({"lift": array([0.25])}, weights), array, [0.5])


def test_every_weight_names_a_term_that_total_accepts():
    terms = {field.name: np.ones(2) for field in fields(RewardWeights)}
    weights = RewardWeights()
    expected = sum(getattr(weights, name) for name in terms)
    np.testing.assert_allclose(reward.total(terms, weights), expected)


def test_wrong_terms_and_weights_are_named():
    with pytest.raises(UnknownNameError, match=r"unknown reward term 'postion'.*Did you mean 'position'"):
        reward.total({"postion": np.zeros(1)}, RewardWeights())
    with pytest.raises(FungraspError, match="at least one term"):
        reward.total({}, RewardWeights())
    with pytest.raises(FungraspError, match=r"^lift: expected a finite number, not nan"):
        RewardWeights(lift=float("nan"))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_terms_stay_within_their_bounds_whatever_happens(seed: int, size: float):
    random = np.random.default_rng(seed)
    points, others = random.normal(size=(2, 5, 4, 3)) * size
    touching, wanted = random.random((2, 5, 4)) < 0.5
    forces, mass = np.abs(random.normal(size=(5, 4))) * size, random.uniform(0.01, 5.0, 5)
    bounds = [
        (reward.position_reward(points, others, np.ones(4)), -1.0, 0.0),
        (reward.approach_reward(points, others, 0.3), -1.0, 0.0),
        (reward.dynamic_contact_weight(points, others, wanted), 0.0, 2.0),
        (reward.contact_reward(touching, wanted, forces, mass, reward.closeness(points, others)), 0.0, 2.0),
        (reward.safety_reward(forces, forces[:, 0]), -1.0, 0.0),
        (reward.posture_reward(points[:, None], others[:, None]), -2.0, 1e-12),
        (reward.lift_reward(points[:, 0, 0], 0.1), 0.0, 1.0),
        (reward.stability_reward(points[:, 0], points[:, 1]), -1.0, 0.0),
    ]
    for values, low, high in bounds:
        assert values.shape == (5,)
        assert (values >= low - 1e-12).all()
        assert (values <= high).all()
