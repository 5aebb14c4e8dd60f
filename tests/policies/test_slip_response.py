"""What sinks in the hand is pressed harder and lifted higher; what is held, or not seen, is left alone."""

from __future__ import annotations

import numpy as np

from fungrasp.policies.slip_response import HARDEST, HIGHEST, SlipResponse


def lifted(palm: np.ndarray, risen: np.ndarray, age: float = 0.1) -> SlipResponse:
    """One robot after a lift. palm, risen: heights at each control step [m], shape [T]."""
    reaction = SlipResponse(1)
    for height, rise in zip(palm, risen, strict=True):
        reaction.update(np.array([True]), np.array([height]), np.array([rise]), np.array([age]))
    return reaction


UP = np.linspace(0.2, 0.35, 20)


def test_what_rises_with_the_palm_is_left_alone():
    jitter = np.random.default_rng(0).normal(0, 0.002, 20)
    reaction = lifted(UP, UP - 0.2 + jitter)
    assert reaction.squeeze[0] == 1.0 and reaction.raised[0] < 0.003


def test_what_sinks_is_lifted_as_high_as_was_asked_and_pressed_harder():
    reaction = lifted(UP, 0.8 * (UP - 0.2))
    assert 0.02 < reaction.raised[0] <= 0.2 * 0.15
    assert 1.7 < reaction.squeeze[0] <= HARDEST


def test_what_stays_behind_takes_the_palm_no_higher_than_allowed():
    reaction = lifted(UP, np.zeros(20))
    assert reaction.raised[0] == HIGHEST and reaction.squeeze[0] == HARDEST


def test_a_pose_that_is_old_says_nothing():
    reaction = lifted(UP, np.zeros(20), age=0.5)
    assert reaction.raised[0] == 0.0 and reaction.squeeze[0] == 1.0


def test_a_new_episode_forgets_the_last():
    reaction = lifted(UP, np.zeros(20))
    reaction.begin(np.array([0]))
    assert reaction.raised[0] == 0.0
    reaction.update(np.array([True]), np.array([0.1]), np.array([0.0]), np.array([0.0]))
    assert reaction.raised[0] == 0.0
