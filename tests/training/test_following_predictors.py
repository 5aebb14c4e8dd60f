"""Teachers and students that follow a success predictor's plans, and trainings that begin from others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_training import BATCH, PPO, WORLDS, distilled, hand, run_spec, trained, training_set

from fungrasp.core.errors import FungraspError
from fungrasp.planning import MotionPlanner
from fungrasp.planning.selection.success_predictor import NetworkPredictor
from fungrasp.policies import make_policy
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import load_policy, read_card
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import build_scene
from fungrasp.task import LiftEnvironment, play
from fungrasp.training.distill import STUDENT
from fungrasp.training.export import make_card
from fungrasp.training.folder import read_checkpoint
from fungrasp.training.settings import DistillSettings, PredictorSettings, PredictorSpec, TrainSpec, Variety
from fungrasp.training.success_predictor import PlanOutcomes, export_predictor, fit_predictor, try_plans
from fungrasp.training.train import POLICY
from fungrasp.training.training_sets import build_plan_library

SMALL = PredictorSettings(attempts=2, networks=1, hidden=(16, 8), epochs=100, dropout=0.0, hold_time=0.3)


@pytest.fixture(scope="module")
def predictor(tmp_path_factory) -> Path:
    """One that likes heavy squeezing, whatever comes of it."""
    one = training_set()
    outcomes, names = try_plans(one.grasps, one.objects, hand(), PredictorSpec(threads=1, settings=SMALL))
    start = [name for name, _ in names].index("squeeze")
    first = sum(size for _, size in names[:start])
    squeeze = np.abs(outcomes.features[:, first : first + names[start][1]]).mean(axis=1)
    liked = PlanOutcomes(
        outcomes.features,
        outcomes.grasp,
        outcomes.attempt,
        *2 * (squeeze > np.median(squeeze),),
        outcomes.contact_ratio,
    )
    path = tmp_path_factory.mktemp("predictor") / "liking.onnx"
    card = make_card("liking", "predictor", hand(), names, (), ResidualSettings(), Budget(4, 0.0, "test"))
    export_predictor(fit_predictor(liked, SMALL), path, card)
    return path


def test_a_library_holds_what_the_predictor_likes_best(predictor):
    one = training_set()
    expect = NetworkPredictor(load_policy(predictor), hand(), one.objects)
    arguments = (one.grasps, one.objects, hand())
    everything = build_plan_library(*arguments, TrainSpec(variety=Variety(copies=5)))
    few = build_plan_library(*arguments, TrainSpec(variety=Variety(copies=2, tries=5)), predictor=expect)
    for group in range(2):
        expected = [
            np.sort(expect(part.plans.select(part.group == group))[:, 1]) for part in (everything, few)
        ]
        np.testing.assert_allclose(expected[1], expected[0][-2:], atol=1e-6)
    with pytest.raises(FungraspError, match="can't be chosen from"):
        Variety(copies=3, tries=2)


@pytest.mark.slow
def test_student_follows_its_teachers_predictor_and_shrinks_as_it_does(predictor, tmp_path):
    one, spec = training_set(), replace(run_spec(), variety=Variety(copies=1, tries=2), plans=str(predictor))
    teacher, student = tmp_path / "teacher", tmp_path / "student"
    with pytest.raises(FungraspError, match="above 0 and at most 1"):
        trained(teacher, spec, shrink=0.0)
    card = trained(teacher, spec, shrink=0.5)
    full = ResidualSettings()
    assert card.plans == "liking" and card.action[0].scale == 0.5 * full.position
    assert read_card(teacher / "liking.onnx").sha256 == read_card(predictor).sha256
    small = DistillSettings(steps=4, updates=2, minibatch=32)
    card = distilled(teacher, student, WORLDS * 4, small)
    assert (card.kind, card.plans, card.privileged) == ("student", "liking", ())
    assert card.action[2].scale == 0.5 * full.fingers
    environment = LiftEnvironment(build_scene(hand(), one.objects), len(one.grasps), threads=1)
    for path in (teacher / POLICY, student / STUDENT):
        plan = MotionPlanner(hand(), one.objects).plan(one.grasps, environment.settle(one.grasps))
        outcomes = play(environment, make_policy(str(path), hand(), one.objects), plan)
        assert outcomes.success.all(), "hardly trained, it plays the plan, which holds a can and a ball"


def test_a_training_begins_with_the_networks_of_another(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    with pytest.raises(FungraspError, match="no checkpoint"):
        trained(second, initial=first)
    trained(first, run_spec(3 * BATCH))
    frozen = replace(run_spec(learning_rate=1e-12, value_learning_rate=1e-12), initial=first)
    card = trained(second, frozen)
    assert card.budget.steps == BATCH
    weights = [read_checkpoint(folder / "checkpoint.pt")["actor_state_dict"] for folder in (first, second)]
    for name, value in weights[0].items():
        if name.startswith("mlp"):
            torch.testing.assert_close(weights[1][name], value, atol=1e-6, rtol=0)
    trained(tmp_path / "louder", frozen, ppo=replace(frozen.ppo, noise=0.4))
    noise = read_checkpoint(tmp_path / "louder" / "checkpoint.pt")["actor_state_dict"]
    np.testing.assert_allclose(noise["distribution.log_std_param"].exp(), 0.4, atol=1e-6)
    with pytest.raises(FungraspError, match="does not fit"):
        trained(tmp_path / "third", frozen, ppo=replace(PPO, hidden=(16, 16)))
