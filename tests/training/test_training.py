"""Environment, PPO, student and runs, in a training of two grasps."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_training import BATCH, PPO, environment, hand, library, run_spec, trained, training_set, unusable

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose
from fungrasp.hands import load_hand
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import load_policy
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.sim2real import NOMINAL, REALITY
from fungrasp.task.features import INPUT_LIMIT
from fungrasp.training.environment import HISTORY, TrainingEnvironment
from fungrasp.training.export import export_policy, make_card
from fungrasp.training.folder import check_environment, environment_state, read_checkpoint
from fungrasp.training.networks import ColoredGaussian, StudentGraph, make_student, tensors
from fungrasp.training.ppo import VALUE_UPDATES, Trainer
from fungrasp.training.training_sets import TrainingSet


def test_a_world_that_diverges_is_named_and_begins_anew(caplog, monkeypatch, tmp_path):
    # MuJoCo writes a log where it is.
    monkeypatch.chdir(tmp_path)
    worlds = environment()
    row = int(worlds.tracker.rows[3])
    engine = worlds.episodes.engine
    engine.set_state(np.array([3]), palm_velocity=np.full((1, 3), 1e12))
    with caplog.at_level(logging.WARNING):
        step = worlds.step(np.zeros((8, worlds.actions)))
    assert worlds.diverged == 1 and step.done[3] and not step.success[3]
    assert step.reward[3] == worlds.settings.reward.drop
    assert str(library().plans.object_name[row]) in caplog.text and f"plan {row}" in caplog.text
    assert np.isfinite(step.reward).all()
    for name in ("robot", "privileged", "value"):
        assert np.isfinite(getattr(worlds.observations, name)).all(), name
    assert not engine.diverged.any()
    worlds.step(np.zeros((8, worlds.actions)))
    assert worlds.diverged == 1


def test_episodes_of_the_reality_protocol_can_be_trained_on():
    """With objects in all sizes of the protocol, whose centers of mass are shifted."""
    worlds = environment(randomization=REALITY, history=True)
    task = worlds.episodes
    scales = {float(scale) for scale in task.sample.object_scale}
    assert len(scales) > 1 and task.sample.center_of_mass_shift.any()
    rows = library().plans.select(worlds.tracker.rows)
    for world, scale in enumerate(task.sample.object_scale.tolist()):
        model = task.scene.models[task.engine.object_index[world]]
        expected = scale * training_set().objects[str(rows.object_name[world])].size
        np.testing.assert_allclose(model.size, expected)
    for _ in range(12):
        step = worlds.step(np.zeros((8, worlds.actions)))
        assert np.isfinite(step.reward).all()
    assert worlds.diverged == 0


def test_without_a_planned_motion_the_reward_counts_the_distance_from_the_grasp():
    worlds = environment(residual=ResidualSettings("guided"), whole=1.0)
    assert not worlds.episodes.task.time.any()
    step = worlds.step(np.zeros((8, worlds.actions)))
    assert step.terms["approach"] < -0.3
    followed = environment(early=(4, 4), whole=0.0)
    assert (followed.episodes.task.time > 0).all()
    assert "approach" not in followed.step(np.zeros((8, followed.actions))).terms


def palm_distance(worlds: TrainingEnvironment) -> np.ndarray:
    """From the palms to where they would be in the grasp [m], shape [W]."""
    target = worlds.tracker.state().target
    now = worlds.episodes.observe()
    goal = compose(now.object_pose, target.palm_in_object)
    return np.linalg.norm(now.palm_pose[:, :3] - goal[:, :3], axis=1)


def test_near_starts_are_on_the_way_to_the_grasp_and_give_way_to_those_of_the_lift_test():
    guided = ResidualSettings("guided")
    near = environment(residual=guided, early=(4, 6), whole=0.0, randomization=NOMINAL)
    assert palm_distance(near).max() < 0.1
    plans = library().plans.select(near.tracker.rows)
    left = plans.closing_step - near.episodes.task.time / plans.control_period
    assert (left > 3.5).all() and (left < 6.5).all()
    widened = environment(residual=guided, early=(4, 6), whole=0.0, widen=(0, 8), randomization=NOMINAL)
    widened.step(np.zeros((8, widened.actions)))
    widened.restart()
    far = environment(residual=guided, whole=1.0, randomization=NOMINAL)
    assert palm_distance(widened).min() > 0.1 and palm_distance(far).min() > 0.1


def test_episodes_may_begin_while_the_hand_closes():
    worlds = environment(residual=ResidualSettings("guided"), early=(-4, -3), whole=0.0)
    plans = library().plans.select(worlds.tracker.rows)
    assert (worlds.episodes.task.time / plans.control_period > plans.closing_step + 2.5).all()
    open_hand = environment(residual=ResidualSettings("guided"), early=(4, 4), whole=0.0)
    assert palm_distance(worlds).max() < palm_distance(open_hand).min()


def test_planned_actions_do_what_the_plans_do():
    worlds = environment(residual=ResidualSettings("guided"), early=(4, 4), whole=0.0, randomization=NOMINAL)
    followed = environment(early=(4, 4), whole=0.0, randomization=NOMINAL)
    followed.begin(np.arange(0))
    for _ in range(14):
        worlds.step(worlds.tracker.planned_action())
    plans = library().plans.select(worlds.tracker.rows)
    step = np.rint(worlds.episodes.task.time / plans.control_period).astype(int)
    fingers = plans.at(step - 1)[1]
    # Smoothing and the actions' reach leave them a little behind.
    assert np.abs(worlds.episodes.task.setpoints.fingers - fingers).max() < 0.12
    assert palm_distance(worlds).max() < 0.02


def test_an_object_that_is_thrown_away_does_not_reach_the_networks_as_such():
    worlds = environment(history=True)
    pose = worlds.episodes.engine.object_pose.copy()
    pose[0, 0] += 50.0
    worlds.episodes.engine.set_state(np.array([0]), object_pose=pose[:1])
    worlds.step(np.zeros((8, worlds.actions)))
    seen = worlds.observations
    for values in (seen.robot, seen.privileged, seen.value, seen.history):
        assert values is not None and np.abs(np.asarray(values)).max() <= INPUT_LIMIT
    assert np.abs(seen.robot).max() == INPUT_LIMIT


def test_plans_are_chosen_by_how_uncertain_their_success_is():
    worlds = environment()
    worlds.success_of_group[:] = [0.5, 1.0]
    chosen = []
    for _ in range(60):
        chosen += library().group[worlds._begin(np.arange(8))].tolist()
    # p (1 - p) + 0.05: 0.30 against 0.05.
    assert np.mean(np.array(chosen) == 0) == pytest.approx(0.3 / 0.35, abs=0.07)


def test_noise_has_the_stated_correlation_and_spread():
    torch.manual_seed(0)
    noise = ColoredGaussian(3, worlds=400, correlation=0.9, init_std=0.2, std_type="log")
    noise.update(torch.zeros(400, 3))
    samples = torch.stack([noise.sample() for _ in range(30)])
    assert samples.std().item() == pytest.approx(0.2, rel=0.05)
    for lag in (1, 5):
        correlation = (samples[lag:] * samples[:-lag]).mean() / samples.var()
        assert correlation.item() == pytest.approx(0.9**lag, abs=0.05)
    for base, wanted in (("plan", 0.95), ("guided", 0.0)):
        chosen = Trainer(environment(residual=ResidualSettings(base)), PPO).actor.distribution
        assert isinstance(chosen, ColoredGaussian) and chosen._correlation == wanted, base


def test_checkpoints_of_other_hands_are_refused(tmp_path):
    worlds = environment()
    state = environment_state(worlds)
    check_environment(tmp_path, state, worlds)
    with pytest.raises(FungraspError, match="of the hand 'leap', not of 'allegro'"):
        check_environment(tmp_path, state | {"hand": load_hand("leap").name}, worlds)
    with pytest.raises(FungraspError, match="other observations"):
        check_environment(tmp_path, state | {"layout": "[]"}, worlds)
    with pytest.raises(FungraspError, match=r"the observation layout 'tiny', not 'full'$"):
        check_environment(tmp_path, state | {"layout_name": "tiny"}, worlds)


def test_a_student_without_estimates_does_not_look_back():
    worlds = environment(history=True)
    torch.manual_seed(2)
    for estimates in (True, False):
        student = make_student(worlds, (32, 16), estimates)
        student.eval()
        seen = tensors(worlds.observations)
        other = seen.clone()
        other["history"] = seen["history"] + torch.randn_like(seen["history"])
        with torch.inference_mode():
            difference = (student(seen) - student(other)).abs().max()
        assert (difference > 0) == estimates


@pytest.mark.parametrize("layout", ["full", "paper"])
def test_the_student_file_does_what_torch_does(tmp_path, layout):
    worlds = environment(history=True, layout=layout)
    torch.manual_seed(1)
    student = make_student(worlds, (32, 16))
    student.eval()
    path = tmp_path / "student.onnx"
    card = make_card(
        "s", "student", hand(), worlds.student_layout, (), worlds.settings.residual, Budget(0, 0, "")
    )
    export_policy(student, path, card)
    network, graph = load_policy(path), StudentGraph(student)
    state = network.initial_state(5)
    window = torch.zeros(5, HISTORY, student.encoder.input_size)
    rng = np.random.default_rng(0)
    for _ in range(2 * HISTORY):
        seen = rng.normal(size=(5, card.input_size)).astype(np.float32)
        action, more, state = network(seen, state)
        with torch.inference_mode():
            wanted, contacts, forces, window = graph(torch.from_numpy(seen), window)
        for ours, theirs in ((action, wanted), (more["contacts"], contacts), (more["forces"], forces)):
            assert np.abs(ours - theirs.numpy()).max() < 1e-3, "weights are stored in half precision"
    assert np.abs(state["history"] - window.numpy()).max() < 1e-6 and window.abs().max() > 0


@pytest.mark.slow
def test_ppo_moves_towards_what_is_paid_for():
    worlds = environment()
    step = worlds.step

    def paid(action):
        result = step(action)
        object.__setattr__(result, "reward", 10.0 * np.clip(action[:, 0], -1, 1))
        return result

    worlds.step = paid
    trainer = Trainer(worlds, PPO)
    rewards = []
    trainer.learn_until(25 * BATCH, lambda p: rewards.append(p.reward))
    assert np.mean(rewards[-5:]) > np.mean(rewards[:5]) + 0.3


def test_a_run_goes_on_and_refuses_other_settings(tmp_path):
    trained(tmp_path)
    card = trained(tmp_path, run_spec(3 * BATCH))
    assert card.budget.steps == 3 * BATCH and card.training_data[0].terms == "free"
    lines = [json.loads(line)["steps"] for line in (tmp_path / "progress.jsonl").read_text().splitlines()]
    assert lines == [BATCH, 2 * BATCH, 3 * BATCH]
    with pytest.raises(FungraspError, match=r"ppo.gamma is 0.99 there, 0.9 here"):
        trained(tmp_path, run_spec(4 * BATCH, gamma=0.9))
    (tmp_path / "checkpoint.pt").write_bytes((tmp_path / "checkpoint.pt").read_bytes()[:-9])
    with pytest.raises(FungraspError, match="damaged"):
        trained(tmp_path, run_spec(4 * BATCH))


def test_imitation_comes_first_and_its_steps_count(tmp_path):
    given = run_spec(3 * BATCH)
    imitating = replace(PPO, imitate=2 * BATCH)
    guided = replace(given.environment, residual=ResidualSettings("guided"))
    with pytest.raises(FungraspError, match="do not fit into a training of"):
        replace(given, environment=guided, ppo=imitating, steps=BATCH)
    trained(tmp_path, given, environment=guided, ppo=imitating)
    lines = [json.loads(line) for line in (tmp_path / "progress.jsonl").read_text().splitlines()]
    assert ["losses/imitation" in line for line in lines] == [True, True, False]
    with pytest.raises(FungraspError, match=r"needs environment\.residual\.base"):
        replace(given, ppo=imitating)


def test_an_imitating_actor_waits_for_the_value_network():
    worlds = environment(history=True, residual=ResidualSettings("guided"))
    trainer = Trainer(worlds, replace(PPO, sees="history", imitate=BATCH))

    def weights() -> dict[str, torch.Tensor]:
        return {name: p.detach().clone() for name, p in trainer.actor.named_parameters()}

    trainer.learn_until(BATCH)
    imitated = weights()
    trainer.learn_until((1 + VALUE_UPDATES) * BATCH)
    assert all(torch.equal(value, imitated[name]) for name, value in weights().items())
    trainer.learn_until((2 + VALUE_UPDATES) * BATCH)
    changed = weights()
    assert not torch.equal(changed["encoder.weight_hh_l0"], imitated["encoder.weight_hh_l0"])


def test_grasps_without_use_are_named(tmp_path):
    one = training_set()
    bad = TrainingSet("bad grasps", unusable(one.grasps), one.objects)
    with pytest.raises(FungraspError, match="bad grasps: none of the grasps can be trained on"):
        trained(tmp_path, sets=[bad])


@pytest.mark.slow
def test_a_killed_run_goes_on_where_its_checkpoint_is(tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path; import small_training as t;"
        "t.trained(Path(sys.argv[2]), t.run_spec(10**9))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(Path(__file__).parents[1] / "helpers"), str(tmp_path)]
    )
    checkpoint = tmp_path / "checkpoint.pt"
    deadline = time.time() + 600
    while not checkpoint.exists() and time.time() < deadline and process.poll() is None:
        time.sleep(0.2)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    steps = read_checkpoint(checkpoint)["steps"]
    card = trained(tmp_path, run_spec(steps + BATCH))
    assert card.budget.steps == steps + BATCH
    lines = [json.loads(line)["steps"] for line in (tmp_path / "progress.jsonl").read_text().splitlines()]
    assert lines == list(range(BATCH, steps + BATCH + 1, BATCH))
