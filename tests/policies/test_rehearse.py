"""Rehearsals decide between plans; planners remember what they have chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand, references, start

import fungrasp.policies.choose as choose
from fungrasp.errors import FungraspError
from fungrasp.policies.choose import Planner
from fungrasp.policies.references import References
from fungrasp.policies.rehearse import RehearsalSettings, rehearse
from fungrasp.transfer import MILD

SHORT = RehearsalSettings(rounds=((3, 1), (2, 2)), hold_time=0.3)
PROMISED = np.array([[0.9, 0.9], [0.5, 0.5], [0.4, 0.4]])
"""Of an open hand, the reference, and a weak copy of it."""


def proposals() -> References:
    """Three plans of each of two grasps; only the second kind holds."""
    good = references()
    opened, weak = (
        replace(good, motion=replace(good.motion, finger_targets=share * good.motion.finger_targets))
        for share in (0.0, 0.3)
    )
    return References.join([opened, good, weak])


def chosen(plans: References, expected: np.ndarray = PROMISED, settings=SHORT, **options):
    return rehearse(plans, expected, grasps_and_objects()[1], hand(), settings, threads=1, **options)


def test_what_holds_wins_over_what_was_promised():
    best, value = chosen(proposals())
    assert best.tolist() == [1, 1]
    held_in_all = (3 + SHORT.prior * 0.5) / (3 + SHORT.prior)
    np.testing.assert_allclose(value, held_in_all)


def test_without_enough_places_the_promise_decides():
    best, value = chosen(proposals(), settings=replace(SHORT, rounds=((1, 1),)))
    assert best.tolist() == [0, 0], "the others were not tried"
    np.testing.assert_allclose(value, SHORT.prior * 0.9 / (1 + SHORT.prior))


def test_a_choice_depends_on_its_own_grasp_alone():
    plans, (best, value) = proposals(), chosen(proposals(), seed=3)
    one, alone = chosen(plans.select(np.array([1, 3, 5])), PROMISED[:, 1:], seed=3)
    assert one[0] == best[1] and alone[0] == value[1]
    parted = chosen(plans, settings=replace(SHORT, chunk=2), seed=3)
    np.testing.assert_array_equal(parted[0], best)
    np.testing.assert_array_equal(parted[1], value)


def test_rehearsals_meet_other_worlds_than_they_are_told():
    heavy = replace(SHORT, randomisation=replace(MILD, mass=(40.0, 50.0)))
    _, value = chosen(proposals(), settings=heavy)
    nothing_held = SHORT.prior * PROMISED[0] / (3 + SHORT.prior)
    np.testing.assert_allclose(value, nothing_held, err_msg="no hand holds an object that is so heavy")


@pytest.mark.parametrize("rounds", [(), ((0, 1),), ((2, 0),)])
def test_empty_rehearsals_are_refused(rounds):
    with pytest.raises(FungraspError, match="rounds"):
        RehearsalSettings(rounds=rounds)


def test_a_planner_remembers_a_task_and_a_seed(monkeypatch):
    asked: list[int] = []

    def plan(task, objects, critic, settings, seed, threads):
        asked.append(seed)
        return references(), np.zeros(2)

    monkeypatch.setattr(choose, "choose_references", plan)
    objects, critic = grasps_and_objects()[1], _Critic()
    planner, task = Planner(), start()
    for seed in (0, 0, 1, 0):
        planner(task, objects, critic, seed)  # type: ignore[arg-type]
    assert asked == [0, 1]
    moved = start()
    moved.settled_pose[:, 0] += 0.01
    planner(moved, objects, critic)  # type: ignore[arg-type]
    assert asked == [0, 1, 0], "another place, another plan"


class _Card:
    sha256 = "of a critic"


class _Critic:
    card = _Card()
