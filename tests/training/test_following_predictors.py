"""Teachers and students that follow the plans of a critic, and trainings that begin from others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from fungrasp.training.library import Variety, build_library
from fungrasp.training.plans import Outcomes, fit_critic, try_plans
from small_training import BATCH, PPO, WORLDS, hand, run_settings, training_set

from fungrasp.errors import FungraspError
from fungrasp.planning.selection.candidates import expect
from fungrasp.policies import make_policy, play
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import load_policy, read_card
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import Worlds, build_scene
from fungrasp.task import LiftTask
from fungrasp.training.checkpoint import read_checkpoint
from fungrasp.training.export import export_critic, make_card
from fungrasp.training.run import POLICY, train
from fungrasp.training.settings import DistillSettings, PlanSettings
from fungrasp.training.student_run import STUDENT, train_student

SMALL = PlanSettings(attempts=2, networks=1, hidden=(16, 8), epochs=100, dropout=0.0, hold_time=0.3)


@pytest.fixture(scope="module")
def critic(tmp_path_factory) -> Path:
    """One that likes heavy squeezing, whatever comes of it."""
    one = training_set()
    outcomes, names = try_plans(one.grasps, one.objects, hand(), SMALL, threads=1)
    start = [name for name, _ in names].index("squeeze")
    first = sum(size for _, size in names[:start])
    squeeze = np.abs(outcomes.features[:, first : first + names[start][1]]).mean(axis=1)
    liked = Outcomes(
        outcomes.features,
        outcomes.grasp,
        outcomes.attempt,
        squeeze > np.median(squeeze),
        outcomes.contact_ratio,
    )
    path = tmp_path_factory.mktemp("critic") / "liking.onnx"
    card = make_card("liking", "critic", hand(), names, (), ResidualSettings(), 10.0, Budget(4, 0.0, "test"))
    export_critic(fit_critic(liked, SMALL), path, card)
    return path


def test_a_library_holds_what_the_critic_likes_best(critic):
    one, network = training_set(), load_policy(critic)
    arguments = (one.grasps, one.objects, hand())
    everything = build_library(*arguments, Variety(copies=5), threads=1)
    few = build_library(*arguments, Variety(copies=2, tries=5), threads=1, critic=network)
    for group in range(2):
        expected = [
            np.sort(expect(network, hand(), part.references.select(part.group == group), one.objects, 10.0))
            for part in (everything, few)
        ]
        np.testing.assert_allclose(expected[1], expected[0][-2:], atol=1e-6)
    with pytest.raises(FungraspError, match="can't be chosen from"):
        Variety(copies=3, tries=2)


def test_student_follows_its_teachers_critic_and_shrinks_as_it_does(critic, tmp_path):
    one, settings = training_set(), replace(run_settings(), variety=Variety(copies=1, tries=2))
    teacher, student = tmp_path / "teacher", tmp_path / "student"
    with pytest.raises(FungraspError, match="above 0 and at most 1"):
        train(teacher, [one], hand(), settings, BATCH, threads=1, plans=critic, shrink=0.0)
    card = train(teacher, [one], hand(), settings, BATCH, threads=1, plans=critic, shrink=0.5)
    full = ResidualSettings()
    assert card.plans == "liking" and card.action[0].scale == 0.5 * full.position
    assert read_card(teacher / "liking.onnx").sha256 == read_card(critic).sha256
    card = train_student(teacher, student, WORLDS * 4, DistillSettings(steps=4), threads=1)
    assert (card.kind, card.plans, card.privileged) == ("student", "liking", ())
    assert card.action[2].scale == 0.5 * full.fingers
    scene = build_scene(hand(), one.objects)
    index = scene.indices(one.grasps.object_name.tolist())
    for path in (teacher / POLICY, student / STUDENT):
        task = LiftTask(scene, one.grasps, Worlds(scene, index, one.grasps.object_mass, threads=1))
        task.reset()
        trials = play(task, make_policy(str(path), task, one.objects))
        assert trials.success.all(), "hardly trained, it plays the reference, which holds a can and a ball"


def test_a_training_begins_with_the_networks_of_another(tmp_path):
    one = training_set()
    first, second = tmp_path / "first", tmp_path / "second"
    with pytest.raises(FungraspError, match="no checkpoint"):
        train(second, [one], hand(), run_settings(), BATCH, threads=1, initial=first)
    train(first, [one], hand(), run_settings(), 3 * BATCH, threads=1)
    frozen = run_settings(learning_rate=1e-12, critic_learning_rate=1e-12)
    card = train(second, [one], hand(), frozen, BATCH, threads=1, initial=first)
    assert card.budget.steps == BATCH
    weights = [read_checkpoint(folder / "checkpoint.pt")["actor_state_dict"] for folder in (first, second)]
    for name, value in weights[0].items():
        if name.startswith("mlp"):
            torch.testing.assert_close(weights[1][name], value, atol=1e-6, rtol=0)
    with pytest.raises(FungraspError, match="does not fit"):
        wide = replace(frozen, ppo=replace(PPO, hidden=(16, 16)))
        train(tmp_path / "third", [one], hand(), wide, BATCH, threads=1, initial=first)
