"""Rehearsals decide between plans; planners remember what they have chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fungrasp.planning.references import References
from planned_grasps import grasps_and_objects, hand, references
from planned_grasps import start as begun

import fungrasp.planning.selection.search as choose
from fungrasp.errors import FungraspError
from fungrasp.planning.selection.candidates import STEP, Pool, Start
from fungrasp.planning.selection.rollouts import Outcome, RehearsalSettings, Tally, blind, rehearse
from fungrasp.planning.selection.search import ChoiceSettings, Planner, SearchSettings, choose_references
from fungrasp.transfer import MILD

SHORT = RehearsalSettings(hold_time=0.3)
ROUNDS, PRIOR = ((3, 1), (2, 2)), 4.0
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


def chosen(plans: References, expected: np.ndarray = PROMISED, rounds=ROUNDS, settings=SHORT, **options):
    """The best of the plans of each grasp, and the success expected of it."""
    tally = Tally.untried(expected, PRIOR)
    rehearse(plans, tally, rounds, grasps_and_objects()[1], hand(), settings, threads=1, **options)
    best = tally.order[0]
    return best, tally.success[best, np.arange(len(best))]


def test_what_holds_wins_over_what_was_promised():
    best, value = chosen(proposals())
    assert best.tolist() == [1, 1]
    held_in_all = (3 + PRIOR * 0.5) / (3 + PRIOR)
    np.testing.assert_allclose(value, held_in_all)


def test_without_enough_places_the_promise_decides():
    best, value = chosen(proposals(), rounds=((1, 1),))
    assert best.tolist() == [0, 0], "the others were not tried"
    np.testing.assert_allclose(value, PRIOR * 0.9 / (1 + PRIOR))


def test_a_choice_depends_on_its_own_grasp_alone():
    plans, (best, value) = proposals(), chosen(proposals(), seed=(3, 0))
    one, alone = chosen(plans.select(np.array([1, 3, 5])), PROMISED[:, 1:], seed=(3, 0))
    assert one[0] == best[1] and alone[0] == value[1]
    parted = chosen(plans, settings=replace(SHORT, chunk=2), seed=(3, 0))
    np.testing.assert_array_equal(parted[0], best)
    np.testing.assert_array_equal(parted[1], value)


def test_rehearsals_meet_other_worlds_than_they_are_told():
    heavy = replace(SHORT, randomisation=replace(MILD, mass=(40.0, 50.0)))
    _, value = chosen(proposals(), settings=heavy)
    nothing_held = PRIOR * PROMISED[0] / (3 + PRIOR)
    np.testing.assert_allclose(value, nothing_held, err_msg="no hand holds an object that is so heavy")


@pytest.mark.parametrize("rounds", [(), ((0, 1),), ((2, 0),)])
def test_empty_rehearsals_are_refused(rounds):
    with pytest.raises(FungraspError, match="rounds"):
        ChoiceSettings(rounds=rounds)


def test_who_follows_the_plans_rehearses_them():
    """An actor that never closes its fingers loses every trial."""

    def idle(task, plans, sensors):
        act = blind(task, plans, sensors)

        def opened():
            asked = act()
            return replace(asked, finger_targets=0.0 * asked.finger_targets)

        return opened

    best, value = chosen(proposals(), actor=idle)
    assert best.tolist() == [0, 0]
    np.testing.assert_allclose(value, PRIOR * 0.9 / (3 + PRIOR))


def test_slip_counts_against_a_plan():
    good = references()
    plans = References.join([good, good])
    tally = Tally.untried(np.full((2, 2), 0.5), PRIOR)
    rehearse(plans, tally, ((2, 1),), grasps_and_objects()[1], hand(), replace(SHORT, contact=0.0, slip=0.01))
    assert (tally.held == 1).all()
    assert (tally.bonus < 0).all() and (tally.bonus >= -0.1).all()


def test_tallies_choose_by_trials_and_grow():
    tally = Tally.untried(np.array([[0.9], [0.2]]), PRIOR)
    assert tally.order[:, 0].tolist() == [0, 1]
    outcome = Outcome(np.array([False, False, True, True]), np.zeros(4), np.zeros(4))
    tally.add(np.array([[0], [1]]), outcome, np.zeros(4))
    assert tally.order[:, 0].tolist() == [0, 1], "3.6 of 6 against 2.8 of 6"
    tally.add(np.array([[0], [1]]), outcome, np.zeros(4))
    assert tally.order[:, 0].tolist() == [1, 0], "3.6 of 8 against 4.8 of 8"
    more = tally.select(np.array([[1]]), np.array([0])).join(Tally.untried(np.array([[0.7]]), PRIOR))
    assert more.tried[:, 0].tolist() == [4, 0]
    np.testing.assert_allclose(more.success[:, 0], [0.6, 0.7])


def test_where_nothing_holds_the_best_plans_are_varied_again(monkeypatch):
    """The second search finds what holds, for the one grasp that needs it."""
    asked: list[tuple[int, int]] = []
    good = references()
    opened = replace(good, motion=replace(good.motion, finger_targets=0.0 * good.motion.finger_targets))

    def propose(start, grasps, attempts, search, spread, **options):
        asked.append((search, len(start)))
        known = good.object_name.tolist()
        rows = np.array([known.index(name) for name in grasps.object_name.tolist()])
        if search == 0:
            plans = References.join([opened, good]).select(rows + 2 * (rows == 1))
        else:
            plans = (good if search == 2 else opened).select(rows)
        tally = Tally.untried(np.full((len(rows) // len(start), len(start)), 0.5), options["prior"])
        return Pool(grasps, plans, tally)

    monkeypatch.setattr(choose, "propose", propose)
    search = SearchSettings(rounds=((4, 1),), parents=2, enough=0.55)
    settings = ChoiceSettings(2, SHORT, rounds=((2, 1),), search=search)
    start, objects = Start.of(begun(), np.zeros(2)), grasps_and_objects()[1]
    plans, value = choose_references(start, hand(), objects, _Critic(), settings, threads=1)  # type: ignore[arg-type]
    assert asked == [(0, 2), (1, 1), (2, 1)]
    assert (value > 0.55).all()
    np.testing.assert_array_equal(plans.motion.finger_targets, good.motion.finger_targets)


def test_a_planner_remembers_each_grasp_and_seed(monkeypatch):
    asked: list[tuple[int, str, int]] = []

    def plan(start, hand, objects, critic, settings, seed, threads, policy, protocol):
        asked.append((seed, "alone" if policy is None else "followed", len(start)))
        rows = [references().object_name.tolist().index(name) for name in start.grasps.object_name.tolist()]
        return references().select(np.array(rows)), np.array(rows, dtype=float)

    monkeypatch.setattr(choose, "choose_references", plan)
    objects, critic = grasps_and_objects()[1], _Critic()
    planner, task = Planner(), begun()
    for seed in (0, 0, 1, 0):
        planner(task, objects, critic, seed)  # type: ignore[arg-type]
    assert asked == [(0, "alone", 2), (1, "alone", 2)]
    nearly, moved = begun(), begun()
    nearly.settled_pose[:] = STEP * np.round(nearly.settled_pose / STEP) + 0.2 * STEP
    moved.settled_pose[1, 0] += 0.01
    planner(nearly, objects, critic)  # type: ignore[arg-type]
    plans, value = planner(moved, objects, critic)  # type: ignore[arg-type]
    assert asked[2:] == [(0, "alone", 1)], "only what lies elsewhere is planned anew"
    assert plans.object_name.tolist() == references().object_name.tolist() and value.tolist() == [0, 1]
    planner(task, objects, critic, 0, critic)  # type: ignore[arg-type]
    assert asked[3:] == [(0, "followed", 2)], "who rehearses matters"
    low = begun()
    low.settled_pose[:, 2] -= 0.02
    plans, _ = planner(low, objects, critic)  # type: ignore[arg-type]
    sunk = plans.settled_pose[:, 2] - references().settled_pose[:, 2]
    np.testing.assert_allclose(
        sunk, -0.02, atol=0.001, err_msg="planned on a table at zero, played where it is"
    )


class _Card:
    sha256 = "of a critic"


class _Critic:
    card = _Card()
