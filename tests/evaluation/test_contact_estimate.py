"""Estimated contacts are compared with the truth, link by link and step by step."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fungrasp.evaluation.contact_estimate import ContactEstimateMeter, ContactEstimates
from fungrasp.task.features import scaled_forces, unscaled_forces

TOUCHING = np.array([[True, True, False, False], [True, False, False, False]])
FORCES = np.array([[2.0, 6.0, 0.0, 0.0], [4.0, 0.0, 0.0, 0.0]])
SAID = np.array([[0.9, 0.2, 0.7, 0.1], [0.6, 0.1, 0.1, 0.1]])


class Guesser:
    """Says the same at every step."""

    def __init__(self) -> None:
        wrong = np.array([1.0, -2.0, 3.0, 0.0])
        self.outputs = {"contacts": SAID, "forces": scaled_forces(FORCES + wrong)}

    def act(self, observation: Any) -> Any:
        return "what the student does"


class World:
    """Two episodes, of which the second may be over."""

    def __init__(self, done: bool = False):
        self.task = SimpleNamespace(done=np.array([False, done]))
        self.engine = SimpleNamespace(
            link_contacts=TOUCHING, link_forces=FORCES, diverged=np.zeros(2, dtype=bool)
        )

    def __len__(self) -> int:
        return 2


def measured(steps: int, done: bool = False) -> ContactEstimates:
    guesser: Any = Guesser()
    world: Any = World(done)
    meter, nothing = ContactEstimateMeter(guesser, world), None
    for _ in range(steps):
        assert meter.act(nothing) == "what the student does"  # pyright: ignore[reportArgumentType]
    return meter.estimates


def test_hits_misses_and_false_alarms_are_counted_by_hand():
    estimates, both = measured(3), np.ones(2, dtype=bool)
    assert estimates.contact_hits.tolist() == [3, 3]
    assert estimates.contact_misses.tolist() == [3, 0]
    assert estimates.contact_false_alarms.tolist() == [3, 0]
    summary = estimates.summary(both)
    assert summary is not None
    assert summary["precision"] == summary["recall"] == summary["f1"] == pytest.approx(2 / 3)
    # Links that touch: off by 1, 2 and 1 N, with 2, 6 and 4 N.
    assert summary["force_error_n"] == pytest.approx(4 / 3)
    assert summary["force_n"] == pytest.approx(4.0)
    second = estimates.summary(np.array([False, True]))
    assert second is not None and second["f1"] == 1.0


def test_episodes_that_are_over_count_no_more():
    assert measured(2, done=True).contact_hits.tolist() == [2, 0]


def test_without_any_contact_there_is_nothing_to_say():
    assert ContactEstimates.none(3).summary(np.ones(3, dtype=bool)) is None


def test_forces_come_back_from_their_scale_up_to_15_newtons():
    forces = np.array([0.0, 1.0, 10.0, 15.0])
    np.testing.assert_allclose(unscaled_forces(scaled_forces(forces)), forces)
    assert unscaled_forces(np.array([1.0]))[0] == pytest.approx(15.0)
