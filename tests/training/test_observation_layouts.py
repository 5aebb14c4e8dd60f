"""Policies of a layout: trained, kept and played with the same inputs."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_training import (
    BATCH,
    WORLDS,
    distilled,
    environment,
    hand,
    library,
    run_spec,
    trained,
    training_set,
)

from fungrasp.core.errors import FungraspError
from fungrasp.policies import StudentPolicy, TeacherPolicy, make_policy
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import read_card
from fungrasp.sim2real import NOMINAL
from fungrasp.task import Action
from fungrasp.training.export import export_policy, make_card
from fungrasp.training.networks import make_networks, tensors
from fungrasp.training.settings import DistillSettings, TrainSpec

INPUTS = {
    ("full", "contacts"): 334 + 3 * 13,
    ("full", "nothing"): 334,
    ("full", "history"): 334,
    ("paper", "contacts"): 108 + 3 * 13,
    ("paper", "nothing"): 108,
    ("paper", "history"): 108 + 6 + 22,
}
"""Numbers that a policy of the Allegro hand gets, by layout and by what it sees of the contacts."""


@pytest.mark.parametrize(("layout", "sees"), list(INPUTS))
def test_a_played_file_acts_as_in_training(tmp_path, layout, sees):
    worlds = environment(layout=layout, history=sees == "history", randomization=NOMINAL)
    torch.manual_seed(3)
    actor = make_networks(worlds, sees, (32, 16), 0.1, 0.5)[0]
    with torch.no_grad():
        actor.mlp[-1].weight.mul_(50.0)
    actor.update_normalization(tensors(worlds.observations))
    actor.eval()
    path = tmp_path / "p.onnx"
    card = make_card(
        "p",
        "teacher" if sees == "contacts" else "student",
        hand(),
        worlds.student_layout if sees == "history" else worlds.layout,
        worlds.privileged_layout if sees == "contacts" else (),
        worlds.settings.residual,
        Budget(0, 0.0, ""),
        layout_name=layout,
    )
    export_policy(actor, path, card)
    assert (read_card(path).layout_name, card.input_size) == (layout, INPUTS[layout, sees])

    policy = make_policy(str(path), hand(), training_set().objects)
    assert isinstance(policy, TeacherPolicy if sees == "contacts" else StudentPolicy)
    episodes, trained = worlds.episodes, []
    step = episodes.step
    episodes.step = lambda action: (trained.append(action), step(action))
    policy.reset(library().plans.select(worlds.tracker.rows), episodes.observe())
    moved: list[Action] = []
    for _ in range(4):
        observation = episodes.observe()
        if isinstance(policy, TeacherPolicy):
            moved.append(policy.act_privileged(observation, episodes.privileged()))
        else:
            moved.append(policy.act(observation))
        with torch.inference_mode():
            worlds.step(actor(tensors(worlds.observations)).numpy())
    # Weights are stored in half precision.
    for ours, theirs in zip(moved, trained, strict=True):
        np.testing.assert_allclose(ours.palm_goal_world, theirs.palm_goal_world, atol=5e-4)
        np.testing.assert_allclose(ours.finger_targets, theirs.finger_targets, atol=2e-3)
    plan = worlds.tracker.plans.at(np.full(WORLDS, 3), worlds.tracker.rows)[1]
    assert np.abs(moved[-1].finger_targets - plan).max() > 0.02, "the network does something"


def of_paper(steps: float = BATCH) -> TrainSpec:
    one = run_spec(steps)
    return replace(one, environment=replace(one.environment, layout="paper"))


def test_trainings_of_another_layout_are_not_gone_on_with(tmp_path):
    full, paper = tmp_path / "full", tmp_path / "paper"
    card = trained(full)
    assert card.layout_name == "full" and card.input_size == INPUTS["full", "contacts"]
    with pytest.raises(FungraspError, match=r'environment.layout is "full" there, "paper" here'):
        trained(full, of_paper(2 * BATCH))
    with pytest.raises(FungraspError, match=r"the observation layout 'full', not 'paper'$"):
        trained(paper, of_paper(), initial=full)
    config = json.loads((full / "config.json").read_text())
    for name, words in (("paper", "'full', not 'paper'"), ("tiny", "layout")):
        config["settings"]["environment"]["layout"] = name
        (full / "config.json").write_text(json.dumps(config))
        with pytest.raises(FungraspError, match=words) as refused:
            distilled(full, tmp_path / f"of-{name}", WORLDS, DistillSettings())
        assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_a_student_has_its_teachers_layout(tmp_path):
    assert trained(tmp_path / "teacher", of_paper()).layout_name == "paper"
    small = DistillSettings(steps=4, updates=2, minibatch=32)
    card = distilled(tmp_path / "teacher", tmp_path / "student", WORLDS * 4, small)
    assert (card.layout_name, card.input_size) == ("paper", INPUTS["paper", "history"])
