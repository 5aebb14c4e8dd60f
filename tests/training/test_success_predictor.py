"""Tried plans, the success predictor that learns from them, and choosing by it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from small_training import hand, training_set

import fungrasp.training.success_predictor as success_predictor
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import PartStore
from fungrasp.planning import make_planner
from fungrasp.planning.selection import SelectionSettings
from fungrasp.planning.selection.success_predictor import NetworkPredictor
from fungrasp.policies import make_policy
from fungrasp.policies.checkpoint.card import Budget
from fungrasp.policies.checkpoint.checkpoint_file import load_policy
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import build_scene
from fungrasp.task import LiftEnvironment, play
from fungrasp.training.export import halved, make_card
from fungrasp.training.settings import PredictorSettings, PredictorSpec
from fungrasp.training.success_predictor import (
    PlanOutcomes,
    PlanTrials,
    cross_validate,
    export_predictor,
    fit_predictor,
    try_plans,
)

SMALL = PredictorSettings(attempts=3, networks=2, hidden=(16, 8), chunk=4, hold_time=0.5)
SPEC = PredictorSpec(threads=1, settings=SMALL)


@cache
def tried() -> tuple[PlanOutcomes, tuple[tuple[str, int], ...]]:
    one = training_set()
    return try_plans(one.grasps, one.objects, hand(), SPEC)


def made_up(count: int = 600) -> PlanOutcomes:
    """Plans that hold where their first feature is positive, as shown where the second is too; six of each
    grasp."""
    features = np.random.default_rng(0).normal(size=(count, 5)).astype(np.float32)
    held = features[:, 0] > 0
    return PlanOutcomes(
        features,
        np.arange(count) // 6,
        np.arange(count) % 6,
        held,
        held & (features[:, 1] > 0),
        np.ones(count),
    )


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


def test_interrupted_episodes_go_on(tmp_path, monkeypatch):
    one, whole = training_set(), tried()[0]
    arguments, store = (one.grasps, one.objects, hand()), PartStore(tmp_path)

    def stop(share: float) -> None:
        if share >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        try_plans(*arguments, SPEC, progress=stop, store=store)
    (file,) = tmp_path.iterdir()
    assert file.stem == PlanTrials(*arguments, SPEC).key(range(4)) and len(tried()[0].success) == 6
    attempt, again = success_predictor._try, []
    monkeypatch.setattr(success_predictor, "_try", lambda *a: again.append(len(a[0])) or attempt(*a))
    outcomes, names = try_plans(*arguments, SPEC, store=store)
    assert again == [2], "only what was missing is tried"
    np.testing.assert_array_equal(outcomes.features, whole.features)
    np.testing.assert_array_equal(outcomes.success, whole.success)
    assert names == tried()[1]
    try_plans(*arguments, replace(SPEC, seed=1), store=store)
    assert again == [2, 4, 2], "outcomes of other episodes don't count"


@pytest.mark.slow
def test_a_predictor_learns_what_makes_plans_hold():
    outcomes = made_up()
    settings = PredictorSettings(networks=2, hidden=(16, 8), epochs=60, minibatch=64, dropout=0.0)
    measured = cross_validate(outcomes, settings)
    assert measured["chosen"] > 0.85 * measured["any"] > 0.5 > measured["mean"]
    predictor = fit_predictor(outcomes, settings)
    good, bad = torch.zeros(1, 5), torch.zeros(1, 5)
    good[0, :2], bad[0, 0] = 2.0, -2.0
    assert (predictor(good) > 0.9).all() and (predictor(bad) < 0.1).all()
    good[0, 1] = -2.0
    assert predictor(good)[0, 0] > 0.9 and predictor(good)[0, 1] < 0.3, "held, not as shown"
    good[0, 1] = 2.0
    again = fit_predictor(outcomes, settings)
    assert torch.equal(predictor(good), again(good)), "same seed, same predictor"


def test_outcomes_that_teach_nothing_are_refused():
    outcomes = made_up()
    rows = np.flatnonzero(outcomes.success)
    with pytest.raises(FungraspError, match="all held"):
        fit_predictor(outcomes.select(rows))


def test_grasps_of_joined_outcomes_stay_apart():
    both = PlanOutcomes.join(made_up(), made_up())
    assert len(np.unique(both.grasp)) == 200 and len(both.success) == 1200


@pytest.mark.slow
def test_a_predictor_chooses_and_its_file_is_a_policy(tmp_path):
    outcomes, names = tried()
    one = training_set()
    pretended = PlanOutcomes(
        outcomes.features,
        outcomes.grasp,
        outcomes.attempt,
        *2 * (outcomes.attempt == 1,),
        outcomes.contact_ratio,
    )
    predictor = fit_predictor(
        pretended, PredictorSettings(networks=1, hidden=(16, 8), epochs=200, dropout=0.0)
    )
    path = tmp_path / "liking.onnx"
    card = make_card("liking", "predictor", hand(), names, (), ResidualSettings(), Budget(6, 0.0, "test"))
    export_predictor(predictor, path, card)
    network = load_policy(path)
    expected = network(outcomes.features)[0][:, 0]
    np.testing.assert_allclose(
        expected, predictor(torch.from_numpy(outcomes.features))[:, 0].detach(), atol=1e-5
    )
    environment = LiftEnvironment(build_scene(hand(), one.objects), 2, threads=1)
    belief = environment.settle(one.grasps)
    wide, parted, alone = (
        make_planner(str(path), hand(), one.objects, settings, threads=1).plan(one.grasps, belief)
        for settings in (
            SelectionSettings(6, rollouts=None),
            SelectionSettings(6, rollouts=None, chunk=4),
            SelectionSettings(1, rollouts=None),
        )
    )
    np.testing.assert_allclose(wide.expected_success, parted.expected_success, atol=1e-5)
    np.testing.assert_allclose(wide.grasp_palm_pose, parted.grasp_palm_pose, atol=1e-6)
    value = NetworkPredictor(network, hand(), one.objects)(wide)
    np.testing.assert_allclose(value[:, 0], wide.expected_success, atol=1e-5)
    np.testing.assert_allclose(value[:, 1], wide.expected_as_shown, atol=1e-5)
    assert (wide.expected_success >= alone.expected_success - 1e-6).all() and len(alone) == 2
    outcome = play(environment, make_policy(str(path), hand(), one.objects), wide)
    assert np.isfinite(outcome.contact_ratio).all()


def test_weights_in_half_precision_halve_the_file_and_change_little():
    onnx = pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    numpy_helper, helper = onnx.numpy_helper, onnx.helper
    random = np.random.default_rng(0)
    weight = random.normal(size=(64, 32)).astype(np.float32)
    bias = np.full(32, 1e5, dtype=np.float32)
    nodes = [helper.make_node("Gemm", ["x", "w", "b"], ["y"])]
    ends = [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", size])
        for name, size in (("x", 64), ("y", 32))
    ]
    weights = [numpy_helper.from_array(weight, "w"), numpy_helper.from_array(bias, "b")]
    graph = helper.make_graph(nodes, "linear", ends[:1], ends[1:], weights)
    opset = [helper.make_opsetid("", 18)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString()
    small = halved(model)
    assert len(small) < 0.6 * len(model)
    x = random.normal(size=(5, 64)).astype(np.float32)
    one, other = (runtime.InferenceSession(m).run(None, {"x": x})[0] for m in (model, small))
    np.testing.assert_allclose(one - bias, other - bias, atol=0.05)
    assert not np.array_equal(one, other)
