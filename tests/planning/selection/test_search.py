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
from fungrasp.planning.selection.candidates import Candidates, Tally
from fungrasp.planning.selection.search import RESOLUTION, SearchPlanner
from fungrasp.planning.selection.settings import RolloutSettings, SelectionSettings
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import NOMINAL
from fungrasp.task import Belief, GraspPlan

SHORT = RolloutSettings(hold_time=0.3)


def plan() -> GraspPlan:
    """Plans that don't know where the person touched."""
    return replace(shown_plan(), shown_places=None, shown_normals=None)


def planner(settings: SelectionSettings) -> SearchPlanner:
    return SearchPlanner(hand(), grasps_and_objects()[1], OpenLoopPolicy(), "", settings, threads=1)


def rows_of(names: list[str]) -> np.ndarray:
    known = plan().object_name.tolist()
    return np.array([known.index(name) for name in names])


@pytest.mark.parametrize(
    "wrong", [{"candidates": 0}, {"confirmations": 0}, {"searches": -1}, {"more_searches": -1}]
)
def test_no_candidates_and_no_rollouts_are_refused(wrong):
    with pytest.raises(FungraspError, match="at least one plan"):
        SelectionSettings(**wrong)


def test_what_planning_costs_is_told_beforehand_and_afterwards():
    settings = SelectionSettings(3, replace(SHORT, randomization=NOMINAL), confirmations=2)
    p = planner(settings).plan(grasps_and_objects()[0], belief())
    fewest, most = settings.rollouts_per_grasp
    assert fewest == 2 and most == 3 + 4 + (3 + 9) * (24 + 4)
    assert p.rollouts is not None and (p.rollouts >= fewest).all() and (p.rollouts <= most).all()
    assert p.expected_success is not None and (p.expected_success > 0.5).all()
    assert SelectionSettings(rollouts=None).rollouts_per_grasp == (0, 0)


@pytest.fixture
def made(monkeypatch) -> list[tuple[int, int]]:
    """Number of each search and of its grasps. Of the first grasp nothing holds before the second search; of
    the other, the second candidate does."""
    calls: list[tuple[int, int]] = []
    opened = replace(plan(), finger_targets=0.0 * plan().finger_targets)

    def propose(single, hand, beliefs, grasps, attempts, spread, *, search, **others):
        calls.append((search, len(beliefs)))
        rows, number = rows_of(grasps.object_name.tolist()), np.arange(len(grasps)) // len(beliefs)
        holds = ((rows == 1) & (number == 1)) | (search == 2)
        plans = GraspPlan.join([opened, plan()]).select(rows + 2 * holds)
        tally = Tally.untried((len(rows) // len(beliefs), len(beliefs)))
        return Candidates(grasps, plans, tally)

    monkeypatch.setattr(search, "propose", propose)
    return calls


def test_a_grasp_is_searched_for_until_a_candidate_holds(made):
    settings = SelectionSettings(2, SHORT, confirmations=2, more=2)
    p = planner(settings).plan(grasps_and_objects()[0], belief())
    assert made == [(0, 2), (1, 1), (2, 1)]
    np.testing.assert_array_equal(p.finger_targets, plan().finger_targets)
    assert p.rollouts is not None and p.rollouts[1] == 3, "one failed, the next held twice"
    assert settings.budget(0) + settings.budget(1) < p.rollouts[0] <= settings.rollouts_per_grasp[1]
    assert p.object_name.tolist() == plan().object_name.tolist()


def test_only_what_often_fails_is_searched_for_longer(made):
    """No candidate is confirmed. The second grasp has one that holds, so it is done after the first search;
    the first grasp has one in the second further search."""
    settings = SelectionSettings(2, SHORT, confirmations=99, more=2, searches=0, more_searches=3)
    planner(settings).plan(grasps_and_objects()[0], belief())
    assert made == [(0, 2), (1, 1), (2, 1)]


def test_where_nothing_holds_little_is_expected(made):
    settings = SelectionSettings(2, SHORT, confirmations=2, more=2, searches=1, more_searches=0)
    p = planner(settings).plan(grasps_and_objects()[0], belief())
    assert p.expected_success is not None and p.expected_as_shown is not None
    assert p.expected_success[0] < 0.2 < 0.6 < p.expected_success[1]
    assert p.rollouts is not None and p.rollouts[0] == settings.rollouts_per_grasp[1]


def test_without_rollouts_the_one_motion_is_planned():
    grasps, objects = grasps_and_objects()
    p = planner(SelectionSettings(6, rollouts=None)).plan(grasps, belief())
    assert p.rollouts is not None and p.rollouts.tolist() == [0, 0]
    # A search rounds beliefs to tenths of a millimeter.
    single = MotionPlanner(hand(), objects).plan(grasps, belief())
    np.testing.assert_allclose(p.grasp_palm_pose, single.grasp_palm_pose, atol=2e-3)


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


def test_plans_that_cannot_be_carried_out_are_not_tried() -> None:
    """Of the candidates only those that squeeze little are allowed: one of them is chosen; where none is
    allowed, one is given without any rollout."""
    settings = SelectionSettings(8, SHORT, confirmations=1, searches=0, more_searches=0, more=8)
    rows = rows_of(["can"])
    grasps, known = grasps_and_objects()[0].select(rows), belief().select(rows)
    allowed: list[float] = []

    def squeeze(plans: GraspPlan) -> np.ndarray:
        return np.abs(plans.finger_targets[:, -1] - plans.grasp_joints).mean(axis=1)

    def gentle(plans: GraspPlan) -> np.ndarray:
        good = squeeze(plans) < np.median(squeeze(plans))
        allowed.extend(squeeze(plans)[good])
        return good

    one = planner(settings)
    chosen = one.plan_within(grasps, known, gentle)
    assert len(allowed) == 4 and squeeze(chosen)[0] in allowed
    none = one.plan_within(grasps, known, lambda p: np.zeros(len(p), bool))
    assert none.expected_success is not None and none.rollouts is not None
    assert none.expected_success[0] == 0 and none.rollouts[0] == 0
    assert isinstance(one, ConstrainedPlanner)
