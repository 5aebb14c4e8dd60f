"""Rollouts decide between plans, in worlds that differ from what is believed as much as the belief says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand, scene
from planned_grasps import plan as shown_plan

import fungrasp.planning.selection.rollouts as rollouts
from fungrasp.planning.selection.candidates import HOPE, HOPE_WEIGHT, Candidates, Tally
from fungrasp.planning.selection.rollouts import RolloutTrials, roll_out
from fungrasp.planning.selection.settings import RolloutSettings, SelectionSettings
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import MODERATE, NOMINAL, EpisodeSample, MeasurementError, Randomization, draw
from fungrasp.task import Action, GraspPlan, LiftEnvironment, Observation, play
from fungrasp.task.use import UseMotion

SHORT = RolloutSettings(hold_time=0.3)


def plan() -> GraspPlan:
    """Plans that don't know where the person touched."""
    return replace(shown_plan(), shown_places=None, shown_normals=None)


def proposals() -> GraspPlan:
    """Three plans of each of two grasps; only the second kind holds."""
    opened, weak = (replace(plan(), finger_targets=share * plan().finger_targets) for share in (0.0, 0.3))
    return GraspPlan.join([opened, plan(), weak])


def candidates(plans: GraspPlan, count: int = 2) -> Candidates:
    """Those of ``count`` grasps, one variation after the other."""
    grasps, _ = grasps_and_objects()
    rows = np.tile(np.arange(count), len(plans) // count)
    return Candidates(grasps.select(rows), plans, Tally.untried((len(plans) // count, count)))


def tried(
    pool: Candidates, times: int = 1, settings=SHORT, policy=None, seed=(0, 0), threads=1, beliefs=None
) -> Tally:
    """How all the candidates did, after so many rollouts of each."""
    objects, count = grasps_and_objects()[1], pool.tally.tried.shape[1]
    beliefs = belief().select(np.arange(count)) if beliefs is None else beliefs
    names = pool.grasps.object_name[:count].tolist()
    policy = policy or OpenLoopPolicy()
    roll = RolloutTrials(objects, hand(), policy, settings, beliefs, names, times, seed, threads)
    chosen, which = (x.ravel() for x in np.indices(pool.tally.tried.shape))
    for _ in range(times):
        roll(pool, np.arange(count), chosen, which)
    return pool.tally


def test_what_holds_is_chosen():
    pool = candidates(proposals())
    tally = tried(pool, 3)
    assert tally.held[1].tolist() == [3, 3] and tally.held[0].tolist() == [0, 0]
    assert (tally.tried == 3).all()
    chosen = pool.best(0.0)
    np.testing.assert_array_equal(chosen.finger_targets, plan().finger_targets)
    common = (tally.held.sum(axis=0) + HOPE_WEIGHT * HOPE) / (9 + HOPE_WEIGHT)
    assert chosen.expected_success is not None
    np.testing.assert_allclose(chosen.expected_success, (3 + HOPE_WEIGHT * common) / (3 + HOPE_WEIGHT))
    assert chosen.rollouts is not None and chosen.rollouts.tolist() == [9, 9]


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


def test_a_result_depends_on_its_own_grasp_alone():
    plans = proposals()
    together = tried(candidates(plans), 2, seed=(3,))
    one = np.array([1])
    grasps = grasps_and_objects()[0].select(np.array([1, 1, 1]))
    alone = replace(candidates(plans.select(np.array([1, 3, 5])), 1), grasps=grasps)
    its = tried(alone, 2, seed=(3,), beliefs=belief().select(one))
    for field in ("held", "shown", "bonus"):
        np.testing.assert_array_equal(getattr(its, field)[:, 0], getattr(together, field)[:, 1])
    parted = tried(candidates(plans), 2, settings=replace(SHORT, chunk=2), seed=(3,), threads=3)
    np.testing.assert_array_equal(parted.bonus, together.bonus)


def test_rollouts_meet_other_worlds_than_are_believed():
    heavy = replace(SHORT, randomization=replace(MODERATE, mass=(40.0, 50.0)))
    assert not tried(candidates(proposals()), settings=heavy).held.any(), "no hand holds what is so heavy"


def test_who_follows_the_plans_follows_them_in_rollouts():
    """A policy that never closes its fingers loses every episode."""

    class Idle(OpenLoopPolicy):
        def act(self, observation: Observation) -> Action:
            asked = super().act(observation)
            return replace(asked, finger_targets=0.0 * asked.finger_targets)

    assert not tried(candidates(proposals()), policy=Idle()).held.any()


def test_each_third_rollout_is_the_whole_motion_in_the_believed_world(monkeypatch):
    seen: list[tuple[float, float, bool]] = []

    def spy(plans, rows, sample, scene, policy, settings, *others):
        seen.append((settings.hold_time, scene.settings.timestep, bool((sample.mass == 1).all())))
        assert (plans.closing_step <= settings.early).all() == (settings.hold_time == 3.0)
        return rollouts.RolloutResults(*np.zeros((5, len(plans))))

    monkeypatch.setattr(rollouts, "roll_out", spy)
    tried(candidates(plan()), 4)
    assert seen == [(0.3, 0.01, False), (0.3, 0.01, False), (3.0, 0.005, True), (0.3, 0.01, False)]
    seen.clear()
    reality = SelectionSettings.for_protocol("reality").rollouts
    assert reality is not None
    tried(candidates(plan()), 2, replace(reality, randomization=MODERATE, rehearsed=MODERATE))
    assert seen == [(3.0, 0.005, False)] * 2, "there each is, in worlds that are not as believed"


def test_slip_counts_against_a_plan():
    tally = tried(candidates(GraspPlan.join([plan(), plan()])), 1, replace(SHORT, contact=0.0, slip=0.01))
    assert (tally.held == 1).all()
    assert (tally.bonus < 0).all() and (tally.bonus >= -0.1).all()


def counted(held: list[list[int]], shown: list[list[int]] | None = None) -> Tally:
    """Of one grasp, a list for each candidate of what its rollouts counted."""
    tally, shown = Tally.untried((len(held), 1)), held if shown is None else shown
    for candidate, (values, kept) in enumerate(zip(held, shown, strict=True)):
        for value, other in zip(values, kept, strict=True):
            one = np.array([candidate]), np.array([0])
            tally.add(*one, np.array([value]), np.array([other]), np.zeros(1))
    return tally


def test_what_holds_is_tried_on_and_what_fails_falls_behind():
    order = np.argsort(-counted([[0], [1], [], [0, 1]]).hope(0.0, 0.0)[:, 0], kind="stable")
    assert order.tolist() == [1, 2, 3, 0]
    impossible = replace(counted([[], []]), possible=np.array([[False], [True]]))
    assert np.isneginf(impossible.hope(0.0, 0.2)[0, 0]) and impossible.expected(impossible.held)[0, 0] == 0


def test_luck_counts_less_where_little_holds():
    lucky, usual = counted([[1], *[[0]] * 9]), counted([[1], *[[1]] * 9])
    assert lucky.expected(lucky.held)[0, 0] < 0.6 < usual.expected(usual.held)[0, 0]


def test_what_was_not_tried_is_not_chosen():
    assert counted([[0], []]).best(0.0)[0, 0] == 0


def test_success_otherwise_than_shown_counts_only_where_it_is_allowed():
    """The first candidate holds always and never as shown, the second as shown in one of three."""
    held = [[1, 1, 1], [1, 0, 0]]
    for weight, shown, best in ((0.0, [1, 0, 0], 1), (0.3, [1, 0, 0], 1), (0.3, [0, 0, 0], 0)):
        assert counted(held, [[0, 0, 0], shown]).best(weight)[0, 0] == best


def test_a_candidate_that_leaves_the_places_loses_to_one_that_keeps_them():
    """Both hold the objects; the person of the first touched elsewhere."""
    away = replace(
        shown_plan(), shown_places=np.asarray(shown_plan().shown_places) + np.array([0.0, 0.0, 0.2])
    )
    tally = tried(candidates(GraspPlan.join([away, shown_plan()])), 2)
    assert (tally.held == 2).all() and not tally.shown[0].any()
    kept = tally.shown[1] > 0
    assert kept.any() and (tally.best(0.0)[0, kept] == 1).all()


# What is believed


def drawn(monkeypatch, beliefs) -> EpisodeSample:
    """What 2,000 rollouts each of two plans, in turn, are told to differ in."""
    seen = []

    def spy(plans, rows, sample, *others):
        seen.append(sample)
        return rollouts.RolloutResults(*np.zeros((5, len(plans))))

    monkeypatch.setattr(rollouts, "roll_out", spy)
    tried(candidates(plan()), 2000, replace(SHORT, rehearsal=10_000), beliefs=beliefs)
    return EpisodeSample.join(seen)


def test_pose_errors_are_as_large_as_the_belief_says(monkeypatch):
    rng = np.random.default_rng(0)
    scale = np.array([0.003, 0.001, 0.0, 0.0, 0.0, 0.1])
    mixed = scale[:, None] * rng.normal(size=(2, 6, 6))
    covariance = mixed @ mixed.mT
    errors = drawn(monkeypatch, replace(belief(), object_pose_covariance=covariance)).object_bias
    for grasp, some in enumerate((errors[::2], errors[1::2])):
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
