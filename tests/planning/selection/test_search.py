"""Search: what holds is found, varied again where nothing does, and remembered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand
from planned_grasps import plan as shown_plan

import fungrasp.planning.selection.search as search
from fungrasp.core.errors import FungraspError
from fungrasp.planning import ConstrainedPlanner, MotionPlanner
from fungrasp.planning.selection import SearchPlanner, SelectionSettings
from fungrasp.planning.selection.candidates import Candidates, CandidateStatistics
from fungrasp.planning.selection.rollouts import RolloutSettings
from fungrasp.planning.selection.search import RESOLUTION
from fungrasp.planning.selection.settings import FurtherSearch
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import NOMINAL
from fungrasp.task import Belief, GraspPlan

SHORT = RolloutSettings(hold_time=0.3)


def plan() -> GraspPlan:
    """Plans that don't know where the person touched."""
    return replace(shown_plan(), shown_places=None, shown_normals=None)


class Liking:
    """Expects most of plans that squeeze most."""

    digest = "of a predictor"

    def __call__(self, plans: GraspPlan) -> np.ndarray:
        squeeze = np.abs(plans.finger_targets[:, -1] - plans.grasp_joints).mean(axis=1)
        return np.repeat(1.0 - np.exp(-5.0 * squeeze)[:, None], 2, axis=1)


def planner(settings: SelectionSettings, predictor=None, policy_digest: str = "") -> SearchPlanner:
    objects = grasps_and_objects()[1]
    predictor = predictor or Liking()
    return SearchPlanner(hand(), objects, predictor, OpenLoopPolicy(), policy_digest, settings, threads=1)


def rows_of(names: list[str]) -> np.ndarray:
    known = plan().object_name.tolist()
    return np.array([known.index(name) for name in names])


@pytest.mark.parametrize("rounds", [(), ((0, 1),), ((2, 0),)])
def test_empty_rollouts_are_refused(rounds):
    with pytest.raises(FungraspError, match="rounds"):
        SelectionSettings(rounds=rounds)
    with pytest.raises(FungraspError, match="rounds"):
        SelectionSettings(first_rounds=rounds)
    with pytest.raises(FungraspError, match="rounds"):
        SelectionSettings(search=FurtherSearch(rounds=rounds))


def test_no_candidates_are_refused():
    with pytest.raises(FungraspError, match="at least one plan"):
        SelectionSettings(candidates=0)


def test_what_planning_costs_is_told_beforehand_and_afterwards():
    settings = SelectionSettings(
        3,
        replace(SHORT, randomization=NOMINAL),
        sure=0.0,
        first_rounds=((2, 1), (1, 2)),
        rounds=((3, 1),),
        search=FurtherSearch(most=0),
    )
    assert settings.rollouts_per_grasp == (4, 7)
    p = planner(settings).plan(grasps_and_objects()[0], belief())
    assert p.rollouts is not None and p.rollouts.tolist() == [4, 4]
    assert p.expected_success is not None and (p.expected_success > 0.4).all()
    assert SelectionSettings().rollouts_per_grasp == (12, 201)
    assert SelectionSettings(rollouts=None).rollouts_per_grasp == (0, 0)


def test_only_grasps_of_which_no_candidate_is_sure_are_tried_on(monkeypatch):
    """Two grasps, of which the first has no plan that holds: it alone gets the second rounds, all of whose
    rollouts count."""
    opened = replace(plan(), finger_targets=0.0 * plan().finger_targets)
    pools: list[Candidates] = []

    def propose(single, predictor, hand, beliefs, grasps, attempts, spread, *, prior, **others):
        rows = rows_of(grasps.object_name.tolist())
        plans = GraspPlan.join([opened, plan()]).select(rows + 2 * (rows == 1))
        expected = np.full((len(rows) // len(beliefs), len(beliefs)), 0.5)
        pools.append(Candidates(grasps, plans, beliefs, CandidateStatistics.untried(expected, prior)))
        return pools[-1]

    monkeypatch.setattr(search, "propose", propose)
    settings = SelectionSettings(
        2,
        SHORT,
        sure=0.55,
        first_rounds=((2, 1),),
        rounds=((2, 2),),
        search=FurtherSearch(most=0),
    )
    p = planner(settings).plan(grasps_and_objects()[0], belief())
    assert p.rollouts is not None and p.rollouts.tolist() == [6, 2]
    np.testing.assert_array_equal(pools[0].statistics.tried, [[3, 1], [3, 1]])
    np.testing.assert_array_equal(pools[0].statistics.held, [[0, 1], [0, 1]])


def test_without_rollouts_the_predictor_alone_decides():
    grasps, objects = grasps_and_objects()
    settings = SelectionSettings(6, rollouts=None)
    best = planner(settings).plan(grasps, belief())
    assert best.rollouts is not None and best.rollouts.tolist() == [0, 0]
    single = MotionPlanner(hand(), objects).plan(grasps, belief())
    # A search rounds beliefs to tenths of a millimeter.
    assert (Liking()(best)[:, 1] >= Liking()(single)[:, 1] - 1e-4).all()
    np.testing.assert_allclose(best.expected_success, Liking()(best)[:, 0], atol=1e-9)
    again = planner(replace(settings, chunk=4)).plan(grasps, belief())
    np.testing.assert_allclose(again.grasp_palm_pose, best.grasp_palm_pose, atol=1e-6)


def test_where_nothing_holds_the_best_plans_are_varied_again(monkeypatch):
    """The second search finds what holds, for the one grasp that needs it."""
    asked: list[tuple[int, int]] = []
    opened = replace(plan(), finger_targets=0.0 * plan().finger_targets)

    def propose(single, predictor, hand, beliefs, grasps, attempts, spread, *, search, prior, **others):
        asked.append((search, len(beliefs)))
        rows = rows_of(grasps.object_name.tolist())
        if search == 0:
            plans = GraspPlan.join([opened, plan()]).select(rows + 2 * (rows == 1))
        else:
            plans = (plan() if search == 2 else opened).select(rows)
        expected = np.full((len(rows) // len(beliefs), len(beliefs)), 0.5)
        return Candidates(grasps, plans, beliefs, CandidateStatistics.untried(expected, prior))

    monkeypatch.setattr(search, "propose", propose)
    further = FurtherSearch(rounds=((4, 1),), parents=2, enough=0.5)
    settings = SelectionSettings(2, SHORT, sure=0.0, first_rounds=((2, 1),), search=further)
    p = planner(settings).plan(grasps_and_objects()[0], belief())
    assert asked == [(0, 2), (1, 1), (2, 1)]
    assert p.expected_success is not None and (p.expected_success > 0.5).all()
    np.testing.assert_array_equal(p.finger_targets, plan().finger_targets)
    assert p.rollouts is not None and p.rollouts.tolist() == [2 + 4 + 4, 2]


@pytest.fixture
def asked(monkeypatch) -> list[tuple[int, int]]:
    """Seeds and numbers of the grasps that are searched for; the plans are those that are known."""
    calls: list[tuple[int, int]] = []

    def found(self, grasps, beliefs: Belief, seed: int, *others) -> GraspPlan:
        calls.append((seed, len(grasps)))
        rows = rows_of(grasps.object_name.tolist())
        chosen = plan().select(rows)
        return replace(
            chosen, object_pose=beliefs.object_pose, expected_success=rows.astype(float), rollouts=rows
        )

    monkeypatch.setattr(SearchPlanner, "_search", found)
    return calls


def test_a_planner_remembers_each_grasp_and_seed(asked):
    grasps, _ = grasps_and_objects()
    one = planner(SelectionSettings())
    done: list[float] = []
    for seed in (0, 0, 1, 0):
        one.plan(grasps, belief(), seed, done.append)
    assert asked == [(0, 2), (1, 2)] and done == [0, 2, 2, 2, 0, 2, 2, 2]
    pose = RESOLUTION * np.round(belief().object_pose / RESOLUTION) + 0.2 * RESOLUTION
    one.plan(grasps, replace(belief(), object_pose=pose))
    moved = belief().object_pose.copy()
    moved[1, 0] += 0.01
    p = one.plan(grasps, replace(belief(), object_pose=moved))
    assert asked[2:] == [(0, 1)], "only what lies elsewhere is planned anew"
    assert p.object_name.tolist() == plan().object_name.tolist()
    assert p.expected_success is not None and p.expected_success.tolist() == [0, 1]


@pytest.mark.parametrize(
    "change",
    [
        {"object_mass": np.array([0.3, 0.3])},
        {"friction": np.array([0.5, 0.5])},
        {"object_pose_covariance": np.tile(1e-6 * np.eye(6), (2, 1, 1))},
        {"servo_stiffness": np.full((2, 16), 0.9)},
    ],
)
def test_another_belief_is_planned_for_anew(asked, change):
    grasps, _ = grasps_and_objects()
    one = planner(SelectionSettings())
    one.plan(grasps, belief())
    one.plan(grasps, replace(belief(), **change))
    assert asked == [(0, 2), (0, 2)]


@pytest.mark.parametrize("known", [True, False])
def test_plans_are_made_on_a_table_at_zero_and_played_where_it_is(asked, known, height=0.02):
    """Whether the table is believed to be there, or found under the objects."""
    grasps, _ = grasps_and_objects()
    one, up = planner(SelectionSettings()), np.array([0, 0, height, 0, 0, 0, 0])
    before = one.plan(grasps, belief())
    there = replace(
        belief(),
        object_pose=belief().object_pose + up,
        palm_pose=belief().palm_pose + up,
        table_height=np.full(2, height if known else 0.0),
    )
    p = one.plan(grasps, there)
    moved = p.object_pose[:, 2] - before.object_pose[:, 2]
    np.testing.assert_allclose(moved, height, atol=0.001)
    if known:
        assert asked == [(0, 2)], "nothing is planned anew where only the table is elsewhere"


def test_plans_that_cannot_be_carried_out_come_last() -> None:
    """Of the candidates only those that squeeze little are allowed: one of them is chosen, although the
    predictor expects most of the others; where none is allowed, the best is given without any rollout."""
    settings = SelectionSettings(candidates=8, rollouts=None)
    rows = rows_of(["can"])
    grasps, known = grasps_and_objects()[0].select(rows), belief().select(rows)

    def squeeze(plans: GraspPlan) -> np.ndarray:
        return np.abs(plans.finger_targets[:, -1] - plans.grasp_joints).mean(axis=1)

    free = planner(settings)
    strongest = squeeze(free.plan(grasps, known))[0]
    seen = []

    def gentle(plans: GraspPlan) -> np.ndarray:
        seen.append(len(plans))
        return squeeze(plans) < np.median(squeeze(plans))

    chosen = free.plan_within(grasps, known, gentle)
    assert seen == [8]
    assert squeeze(chosen)[0] < strongest
    assert chosen.expected_success[0] > 0
    none = planner(replace(settings, rollouts=SHORT)).plan_within(
        grasps, known, lambda p: np.zeros(len(p), bool)
    )
    assert none.expected_success[0] == 0 and none.rollouts[0] == 0
    assert isinstance(free, ConstrainedPlanner)
