"""Intervals and means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fungrasp.core.formats.text_files import finite
from fungrasp.evaluation.statistics import mean_over_groups, wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (5, 10, 0.2366, 0.7634),
        (81, 263, 0.2553, 0.3662),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_intervals_known_from_tables(successes, trials, low, high):
    """The last two: Newcombe, Statistics in Medicine 17 (1998), table I."""
    np.testing.assert_allclose(wilson_interval(successes, trials), (low, high), atol=6e-5)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_interval_holds_the_rate_and_mirrors(pair):
    successes, trials = pair
    low, high = wilson_interval(successes, trials)
    assert 0 <= low <= successes / trials + 1e-12 and successes / trials <= high + 1e-12 <= 1 + 1e-9
    mirrored = wilson_interval(trials - successes, trials)
    np.testing.assert_allclose((1 - high, 1 - low), mirrored, atol=1e-12)


def test_every_object_counts_once():
    assert mean_over_groups(np.array([1.0, 1.0, 1.0, 0.0]), ["a", "a", "a", "b"]) == 0.5


def test_nothing_that_is_not_finite_reaches_json():
    value = finite({"a": np.array([1.0, np.nan]), "b": (np.float64(np.inf), np.bool_(True)), 3: np.int64(2)})
    assert value == {"a": [1.0, None], "b": [None, True], "3": 2}
    assert type(value["b"][1]) is bool and type(value["3"]) is int
