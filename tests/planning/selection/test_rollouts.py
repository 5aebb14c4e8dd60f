"""Rollouts decide between plans, in worlds that differ from what is believed as much as the belief says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand, scene
from planned_grasps import plan as shown_plan

import fungrasp.planning.selection.rollouts as rollouts
from fungrasp.planning.selection.candidates import Candidates, CandidateStatistics
from fungrasp.planning.selection.rollouts import RolloutSettings, Rounds, roll_out, try_candidates
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import MODERATE, NOMINAL, EpisodeSample, MeasurementError, Randomization, draw
from fungrasp.task import Action, GraspPlan, LiftEnvironment, Observation, play
from fungrasp.task.use import UseMotion

SHORT = RolloutSettings(hold_time=0.3)
ROUNDS, PRIOR = ((3, 1), (2, 2)), 4.0
PROMISED = np.array([[0.9, 0.9], [0.5, 0.5], [0.4, 0.4]])
"""Of an open hand, the plan, and a weak copy of it."""
HOPED = 3 * 0.9 + 3 * 0.5 + 0.4
"""Rollouts of ``ROUNDS`` that are expected to hold."""
NOTHING_HELD = PRIOR * 0.9 * PRIOR / (HOPED + PRIOR) / (3 + PRIOR)
"""What is then expected of the best where none does."""


def plan() -> GraspPlan:
    """Plans that don't know where the person touched."""
    return replace(shown_plan(), shown_places=None, shown_normals=None)


def proposals() -> GraspPlan:
    """Three plans of each of two grasps; only the second kind holds."""
    opened, weak = (replace(plan(), finger_targets=share * plan().finger_targets) for share in (0.0, 0.3))
    return GraspPlan.join([opened, plan(), weak])


def candidates(plans: GraspPlan, expected: np.ndarray = PROMISED, beliefs=None) -> Candidates:
    grasps, _ = grasps_and_objects()
    beliefs = belief() if beliefs is None else beliefs
    rows = np.tile(np.arange(len(beliefs)), len(expected))
    return Candidates(grasps.select(rows), plans, beliefs, CandidateStatistics.untried(expected, PRIOR))


def tried(
    pool: Candidates, rounds: Rounds = ROUNDS, settings=SHORT, policy=None, seed=(0, 0), threads=1
) -> tuple[np.ndarray, np.ndarray]:
    """The best of the candidates of each grasp, and the success expected of it."""
    objects = grasps_and_objects()[1]
    try_candidates(pool, rounds, objects, hand(), policy or OpenLoopPolicy(), settings, seed, threads)
    best = pool.statistics.order[0]
    return best, pool.statistics.success[best, np.arange(len(best))]


def test_what_holds_wins_over_what_was_promised():
    pool = candidates(proposals())
    best, value = tried(pool)
    assert best.tolist() == [1, 1]
    right = (3 + PRIOR) / (HOPED + PRIOR)
    np.testing.assert_allclose(value, (3 + PRIOR * 0.5 * right) / (3 + PRIOR))
    assert pool.statistics.tried.sum(axis=0).tolist() == [3 + 4, 3 + 4]
    chosen, expected = pool.best()
    np.testing.assert_array_equal(chosen.finger_targets, plan().finger_targets)
    np.testing.assert_array_equal(expected, value)


def test_what_does_not_withstand_its_use_counts_half(monkeypatch):
    """Two objects that are held, one of which is then pulled out of the hand."""
    tasks = np.array(["pull", "rest"])
    torn = UseMotion("tear", ("pull",), 0.4, pull=300.0)
    monkeypatch.setattr(rollouts, "load_use_motions", lambda: {"tear": torn})
    drawn = draw(NOMINAL, 2, len(hand().joint_names), np.random.default_rng(0))
    settings = replace(SHORT, timestep=scene().settings.timestep, randomization=NOMINAL)
    arguments = plan(), belief(), drawn, scene(), OpenLoopPolicy(), settings, 1
    assert roll_out(*arguments).success.tolist() == [1.0, 1.0]
    assert roll_out(*arguments, tasks).success.tolist() == pytest.approx([0.5, 1.0], abs=0.05)


def test_a_use_whose_simulation_breaks_down_counts_nothing(monkeypatch):
    wild = UseMotion("explode", ("pull",), 0.4, pull=1e14)
    monkeypatch.setattr(rollouts, "load_use_motions", lambda: {"explode": wild})
    drawn = draw(NOMINAL, 2, len(hand().joint_names), np.random.default_rng(0))
    settings = replace(SHORT, timestep=scene().settings.timestep, randomization=NOMINAL)
    found = roll_out(plan(), belief(), drawn, scene(), OpenLoopPolicy(), settings, 1, np.array(["pull", ""]))
    assert found.success.tolist() == [0.0, 1.0]


def test_a_way_that_is_not_free_is_tried_from_its_beginning():
    class Watch(OpenLoopPolicy):
        def reset(self, plan: GraspPlan, observation: Observation) -> None:
            super().reset(plan, observation)
            self.began = observation.time.copy()

    drawn = draw(NOMINAL, 2, len(hand().joint_names), np.random.default_rng(0))
    settings = replace(SHORT, timestep=scene().settings.timestep, randomization=NOMINAL)
    plans, policy = replace(plan(), path_collision=np.array([0.01, 0.0])), Watch()
    roll_out(plans, belief(), drawn, scene(), policy, settings, 1)
    np.testing.assert_allclose(policy.began, [0.0, 0.1 * (plan().closing_step[1] - settings.early)])


def test_without_enough_places_the_promise_decides():
    best, value = tried(candidates(proposals()), rounds=((1, 1),))
    assert best.tolist() == [0, 0], "the others were not tried"
    np.testing.assert_allclose(value, PRIOR * 0.9 * PRIOR / (0.9 + PRIOR) / (1 + PRIOR))


def test_a_choice_depends_on_its_own_grasp_alone():
    plans = proposals()
    best, value = tried(candidates(plans), seed=(3, 0))
    one = np.array([1])
    alone = candidates(plans.select(np.array([1, 3, 5])), PROMISED[:, 1:], belief().select(one))
    alone = replace(alone, grasps=grasps_and_objects()[0].select(np.array([1, 1, 1])))
    its, expected = tried(alone, seed=(3, 0))
    assert its[0] == best[1] and expected[0] == value[1]
    parted = tried(candidates(plans), settings=replace(SHORT, chunk=2), seed=(3, 0), threads=3)
    np.testing.assert_array_equal(parted[0], best)
    np.testing.assert_array_equal(parted[1], value)


def test_rollouts_meet_other_worlds_than_are_believed():
    heavy = replace(SHORT, randomization=replace(MODERATE, mass=(40.0, 50.0)))
    _, value = tried(candidates(proposals()), settings=heavy)
    np.testing.assert_allclose(value, NOTHING_HELD, err_msg="no hand holds an object that is so heavy")


def test_who_follows_the_plans_follows_them_in_rollouts():
    """A policy that never closes its fingers loses every episode."""

    class Idle(OpenLoopPolicy):
        def act(self, observation: Observation) -> Action:
            asked = super().act(observation)
            return replace(asked, finger_targets=0.0 * asked.finger_targets)

    best, value = tried(candidates(proposals()), policy=Idle())
    assert best.tolist() == [0, 0]
    np.testing.assert_allclose(value, NOTHING_HELD)


def test_slip_counts_against_a_plan():
    pool = candidates(GraspPlan.join([plan(), plan()]), np.full((2, 2), 0.5))
    tried(pool, ((2, 1),), replace(SHORT, contact=0.0, slip=0.01))
    statistics = pool.statistics
    assert (statistics.held == 1).all()
    assert (statistics.bonus < 0).all() and (statistics.bonus >= -0.1).all()


def test_statistics_choose_by_episodes_and_grow():
    statistics = CandidateStatistics.untried(np.array([[0.9], [0.2]]), PRIOR)
    assert statistics.order[:, 0].tolist() == [0, 1]
    success = np.array([False, False, True, True])
    statistics.add(np.array([[0], [1]]), success, success, np.zeros(4))
    assert statistics.order[:, 0].tolist() == [0, 1], "3.6 of 6 against 2.8 of 6"
    statistics.add(np.array([[0], [1]]), success, success, np.zeros(4))
    assert statistics.order[:, 0].tolist() == [1, 0], "3.6 of 8 against 4.8 of 8"
    more = statistics.select(np.array([[1]]), np.array([0]))
    more = more.join(CandidateStatistics.untried(np.array([[0.7]]), PRIOR))
    assert more.tried[:, 0].tolist() == [4, 0]
    np.testing.assert_allclose(more.success[:, 0], [0.6, 0.7])


def test_success_otherwise_than_shown_counts_only_where_it_is_allowed():
    """The first candidate holds always and never as shown, the second as shown in one of three."""
    held, shown = np.array([1.0] * 3 + [1.0, 0.0, 0.0]), np.array([0.0] * 3 + [1.0, 0.0, 0.0])
    for weight, kept in ((0.0, shown), (0.3, shown), (0.3, np.zeros(6))):
        statistics = CandidateStatistics.untried(np.full((2, 1), 0.5), 0.1, None, weight)
        statistics.add(np.array([[0], [1]]), held, kept, np.zeros(6))
        assert statistics.order[0, 0] == (0 if not kept.any() else 1)
    np.testing.assert_allclose(statistics.value[0, 0], 0.3 * 3.05 / 3.1, atol=0.01)


def test_a_candidate_that_leaves_the_places_loses_to_one_that_keeps_them():
    """Both hold the objects; the person of the first touched elsewhere."""
    away = replace(
        shown_plan(), shown_places=np.asarray(shown_plan().shown_places) + np.array([0.0, 0.0, 0.2])
    )
    pool = candidates(GraspPlan.join([away, shown_plan()]), np.full((2, 2), 0.5))
    tried(pool, ((2, 2),))
    assert (pool.statistics.held == 2).all() and not pool.statistics.shown[0].any()
    for grasp in range(2):
        if pool.statistics.shown[1, grasp]:
            assert pool.statistics.order[0, grasp] == 1
    assert pool.statistics.shown[1].any()


def test_candidates_that_fail_lower_what_is_expected_of_those_not_tried():
    """Three of four were tried once and lost, each expected to hold in 9 of 10; of another grasp all held."""
    statistics = CandidateStatistics.untried(np.full((4, 2), 0.9), 4.0)
    tried = np.array([[0, 0], [1, 1], [2, 2]])
    held = np.tile([False, True], 3)
    statistics.add(tried, held, held, np.zeros(6))
    right = 4.0 / (3 * 0.9 + 4.0)
    np.testing.assert_allclose(statistics.success[:, 0], [*3 * [3.6 * right / 5], 0.9 * right])
    np.testing.assert_allclose(statistics.success[:, 1], [*3 * [4.6 / 5], 0.9])


# What is believed


def drawn(monkeypatch, beliefs) -> EpisodeSample:
    """What 4,000 rollouts of each of two plans are told to differ in."""
    seen = []

    def spy(plans, rows, sample, *others):
        seen.append(sample)
        return rollouts.RolloutResults(*np.zeros((5, len(plans))))

    monkeypatch.setattr(rollouts, "roll_out", spy)
    tried(candidates(GraspPlan.join([plan()]), np.full((1, 2), 0.5), beliefs), ((1, 4000),))
    return seen[0]


def test_pose_errors_are_as_large_as_the_belief_says(monkeypatch):
    rng = np.random.default_rng(0)
    scale = np.array([0.003, 0.001, 0.0, 0.0, 0.0, 0.1])
    mixed = scale[:, None] * rng.normal(size=(2, 6, 6))
    covariance = mixed @ mixed.mT
    errors = drawn(monkeypatch, replace(belief(), object_pose_covariance=covariance)).object_bias
    for grasp, some in enumerate(errors.reshape(2, 4000, 6)):
        np.testing.assert_allclose(np.cov(some.T), covariance[grasp], atol=0.1 * covariance[grasp].max())
        assert np.abs(some[:, 2:5]).max() < 1e-4, "what is sure is not varied"
    spread = drawn(monkeypatch, belief()).object_bias.std(axis=0)
    assert (spread[:3] > 0.0005).all() and (spread[:3] < 0.006).all(), "without one, those of the rollouts"


def test_guessed_masses_are_drawn_by_their_spread(monkeypatch):
    guessed = np.log(drawn(monkeypatch, replace(belief(), object_mass_spread=np.full(2, 0.62))).mass)
    known = np.log(drawn(monkeypatch, belief()).mass)
    assert np.abs(guessed).max() <= 2 * 0.62 + 1e-9 and guessed.std() > 1.5 * known.std()


def test_rollouts_happen_in_the_hand_that_is_believed():
    """A hand whose servos are known to be limp holds nothing, and the world is slippery if it is believed to
    be."""
    some, nominal = plan(), draw(NOMINAL, 2, 16, np.random.default_rng(0))
    settings = replace(SHORT, randomization=NOMINAL)

    def held(**beliefs) -> list[bool]:
        believed = replace(belief(), **beliefs)
        found = roll_out(some, believed, nominal, scene(), OpenLoopPolicy(), settings, 1)
        return found.success.tolist()

    assert held() == [True, True]
    assert held(servo_stiffness=np.full((2, 16), 0.05)) == [False, False]
    assert held(friction=np.full(2, 0.05)) == [False, False]
    assert held(servo_stiffness=np.stack([np.ones(16), np.full(16, 0.05)])) == [True, False]


def test_rollouts_have_no_jitter_and_no_gaps():
    """So that they are the same whatever is tried beside them."""
    noisy = Randomization(
        joint_error=MeasurementError(0.0, 0.1),
        object_position_error=MeasurementError(0.0, 0.1),
        tracker_dropout=0.5,
    )
    seen: list[Observation] = []

    class Watching(OpenLoopPolicy):
        def act(self, observation: Observation) -> Action:
            seen.append(observation)
            return super().act(observation)

    sample = draw(noisy, 2, 16, np.random.default_rng(0))
    settings = replace(SHORT, randomization=noisy)
    roll_out(plan(), belief(), sample, scene(), Watching(), settings, 1)
    np.testing.assert_allclose(seen[0].object_pose, plan().object_pose, atol=1e-9)
    assert all((observation.object_pose_age == 0).all() for observation in seen)


def test_a_rollout_is_an_episode_of_the_lift_test():
    """The same plan, from the same step, held as long."""
    drawn = draw(NOMINAL, 2, 16, np.random.default_rng(0))
    settings = replace(SHORT, randomization=NOMINAL, timestep=0.005)
    found = roll_out(plan(), belief(), drawn, scene(), OpenLoopPolicy(), settings, 1)
    environment = LiftEnvironment(
        scene(), 2, protocol=replace(LiftEnvironment(scene(), 1).protocol, hold_time=0.3), threads=1
    )
    environment.begin(np.arange(2), plan(), plan().closing_step - settings.early, drawn)
    outcomes = play(environment, OpenLoopPolicy(), plan())
    np.testing.assert_array_equal(found.success, outcomes.success)
    np.testing.assert_array_equal(found.contact_ratio, outcomes.contact_ratio)
    np.testing.assert_array_equal(found.slip, outcomes.sim_distance_hand_mm_s)
