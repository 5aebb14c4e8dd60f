"""Tried plans, the critic that learns from them, and choosing by it."""

from __future__ import annotations

from functools import cache

import fungrasp.training.plans as plans
import numpy as np
import pytest
import torch
from fungrasp.training.plans import Outcomes, cross_validate, fit_critic, try_plans
from small_training import hand, training_set

from fungrasp.errors import FungraspError
from fungrasp.planning.selection.candidates import Start
from fungrasp.planning.selection.search import ChoiceSettings, choose_references
from fungrasp.policies import make_policy, play
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import load_policy
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import Worlds, build_scene
from fungrasp.task import LiftTask
from fungrasp.training.export import export_critic, make_card
from fungrasp.training.settings import PlanSettings

SMALL = PlanSettings(attempts=3, networks=2, hidden=(16, 8), chunk=4, hold_time=0.5)


@cache
def tried() -> tuple[Outcomes, tuple[tuple[str, int], ...]]:
    one = training_set()
    return try_plans(one.grasps, one.objects, hand(), SMALL, threads=1)


def made_up(count: int = 600) -> Outcomes:
    """Plans that hold where their first feature is positive, six of each grasp."""
    features = np.random.default_rng(0).normal(size=(count, 5)).astype(np.float32)
    return Outcomes(features, np.arange(count) // 6, np.arange(count) % 6, features[:, 0] > 0, np.ones(count))


def settled_task() -> LiftTask:
    one = training_set()
    scene = build_scene(hand(), one.objects)
    index = np.array([scene.objects.index(name) for name in one.grasps.object_name.tolist()])
    task = LiftTask(scene, one.grasps, Worlds(scene, index, one.grasps.object_mass, threads=1))
    task.reset()
    return task


def test_every_variation_is_tried_once_whatever_the_chunk():
    outcomes, names = tried()
    assert sorted(zip(outcomes.grasp.tolist(), outcomes.attempt.tolist(), strict=True)) == [
        (grasp, attempt) for grasp in range(2) for attempt in range(3)
    ]
    assert outcomes.features.shape == (6, sum(size for _, size in names))
    assert np.isfinite(outcomes.features).all()
    assert outcomes.success[outcomes.attempt == 0].all(), "the reference holds a can and a ball"
    first = outcomes.features[outcomes.attempt == 0]
    assert not np.allclose(first, outcomes.features[outcomes.attempt == 1])


def test_interrupted_trials_go_on(tmp_path, monkeypatch):
    one, whole = training_set(), tried()[0]
    arguments = (one.grasps, one.objects, hand(), SMALL)

    def stop(done: int) -> None:
        if done >= SMALL.chunk:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        try_plans(*arguments, threads=1, progress=stop, keep=tmp_path)
    (tmp_path / "trials-000004.npz").write_bytes(b"half a file")
    attempt, again = plans._try, []
    monkeypatch.setattr(plans, "_try", lambda *a: again.append(len(a[0])) or attempt(*a))
    outcomes, names = try_plans(*arguments, threads=1, keep=tmp_path)
    assert again == [2], "only what was missing is tried"
    np.testing.assert_array_equal(outcomes.features, whole.features)
    np.testing.assert_array_equal(outcomes.success, whole.success)
    assert names == tried()[1]
    try_plans(*arguments, seed=1, threads=1, keep=tmp_path)
    assert again == [2, 4, 2], "outcomes of other trials don't count"


def test_a_critic_learns_what_makes_plans_hold():
    outcomes = made_up()
    settings = PlanSettings(networks=2, hidden=(16, 8), epochs=60, minibatch=64, dropout=0.0)
    measured = cross_validate(outcomes, settings)
    assert measured["chosen"] > 0.95 > 0.6 > measured["mean"]
    critic = fit_critic(outcomes, settings)
    good, bad = torch.zeros(1, 5), torch.zeros(1, 5)
    good[0, 0], bad[0, 0] = 2.0, -2.0
    assert critic(good) > 0.9 > 0.1 > critic(bad)
    again = fit_critic(outcomes, settings)
    assert torch.equal(critic(good), again(good)), "same seed, same critic"


def test_outcomes_that_teach_nothing_are_refused():
    outcomes = made_up()
    rows = np.flatnonzero(outcomes.success)
    with pytest.raises(FungraspError, match="all held"):
        fit_critic(outcomes.select(rows))


def test_grasps_of_joined_outcomes_stay_apart():
    both = Outcomes.join(made_up(), made_up())
    assert len(np.unique(both.grasp)) == 200 and len(both.success) == 1200


def test_a_critic_chooses_and_plays(tmp_path):
    outcomes, names = tried()
    pretended = Outcomes(
        outcomes.features, outcomes.grasp, outcomes.attempt, outcomes.attempt == 1, outcomes.contact_ratio
    )
    critic = fit_critic(pretended, PlanSettings(networks=1, hidden=(16, 8), epochs=200, dropout=0.0))
    path = tmp_path / "critic.onnx"
    card = make_card("critic", "critic", hand(), names, (), ResidualSettings(), 10.0, Budget(6, 0.0, "test"))
    export_critic(critic, path, card)
    network, task, objects = load_policy(path), settled_task(), training_set().objects
    expected = network(outcomes.features)[0][:, 0]
    np.testing.assert_allclose(
        expected, critic(torch.from_numpy(outcomes.features))[:, 0].detach(), atol=1e-5
    )
    start = Start.of(task, np.zeros(2))
    whole, score = choose_references(start, hand(), objects, network, ChoiceSettings(6, rehearsal=None))
    parted, again = choose_references(
        start, hand(), objects, network, ChoiceSettings(6, rehearsal=None, chunk=4)
    )
    np.testing.assert_allclose(score, again, atol=1e-5)
    np.testing.assert_allclose(whole.motion.wrist, parted.motion.wrist, atol=1e-6)
    alone, one = choose_references(start, hand(), objects, network, ChoiceSettings(1, rehearsal=None))
    assert (score >= one - 1e-6).all() and len(alone) == 2
    trials = play(task, make_policy(str(path), task, objects))
    assert np.isfinite(trials.contact_ratio).all()
