"""A delayed signal is the signal, later."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fungrasp.errors import FungraspError
from fungrasp.transfer import Delay, delay_steps


@given(
    st.lists(st.integers(0, 5), min_size=1, max_size=4),
    st.integers(0, 3),
    st.integers(0, 20),
    st.integers(0, 20),
)
def test_values_return_their_number_of_pushes_later(steps, spare, before, after):
    """Also over several turns of the ring, and after a reset in the middle of one."""
    count = len(steps)
    delay = Delay(np.full((count, 2), -1.0), longest=max(steps) + spare)
    for _ in range(before):
        delay.push(np.full((count, 2), 99.0))
    delay.reset(np.arange(count), np.full((count, 2), -2.0), np.array(steps))
    for now in range(after):
        value = np.stack([np.full(count, float(now)), np.arange(count)], axis=1)
        result = delay.push(value)
        for world, late in enumerate(steps):
            expected = [now - late, world] if now >= late else [-2.0, -2.0]
            np.testing.assert_array_equal(result[world], expected)


def test_a_reset_leaves_other_worlds_alone():
    delay = Delay(np.zeros(3), longest=2)
    delay.reset(np.arange(3), np.array([-1.0, -2.0, -3.0]), np.array([2, 1, 0]))
    np.testing.assert_array_equal(delay.push(np.array([1.0, 2.0, 3.0])), [-1.0, -2.0, 3.0])
    delay.reset(np.array([1]), np.array([7.0]), np.array([2]))
    np.testing.assert_array_equal(delay.push(np.array([10.0, 20.0, 30.0])), [-1.0, 7.0, 30.0])
    np.testing.assert_array_equal(delay.push(np.array([100.0, 200.0, 300.0])), [1.0, 7.0, 300.0])
    np.testing.assert_array_equal(delay.push(np.array([0.0, 0.0, 0.0])), [10.0, 20.0, 0.0])


def test_what_comes_out_is_not_changed_by_later_pushes():
    delay = Delay(np.zeros((1, 2)), longest=0)
    value = np.ones((1, 2))
    result = delay.push(value)
    value[:] = 5.0
    delay.push(np.full((1, 2), 9.0))
    np.testing.assert_array_equal(result, 1.0)


def test_delays_are_the_nearest_numbers_of_steps():
    np.testing.assert_array_equal(delay_steps(np.array([0.0, 0.009, 0.011, 0.1]), 0.02), [0, 0, 1, 5])
    np.testing.assert_array_equal(delay_steps(np.array([0.04, 0.06, 0.1]), 0.1), [0, 1, 1])


def test_impossible_delays_are_refused():
    with pytest.raises(FungraspError, match="can't be negative: -1 steps"):
        Delay(np.zeros(1), longest=-1)
    delay = Delay(np.zeros(2), longest=3)
    with pytest.raises(FungraspError, match="must be 0 to 3 steps, not 1 to 4"):
        delay.reset(np.arange(2), np.zeros(2), np.array([1, 4]))
    with pytest.raises(FungraspError, match="must be 0 to 3 steps, not -1 to 0"):
        delay.reset(np.arange(2), np.zeros(2), np.array([-1, 0]))
