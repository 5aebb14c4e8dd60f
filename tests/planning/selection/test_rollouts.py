"""Rollouts decide between plans, in worlds that differ from what is believed as much as the belief says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand, plan, scene

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
    np.testing.assert_allclose(value, (3 + PRIOR * 0.5) / (3 + PRIOR))
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
