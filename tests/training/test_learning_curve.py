"""Learning curves: measured beside a training, which they leave alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from small_training import BATCH, environment, hand, library, run_spec, trained, training_set

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.retargeting import retarget
from fungrasp.training import learning_curve
from fungrasp.training.folder import read_checkpoint
from fungrasp.training.learning_curve import CURVE, LearningCurve, curve_svg, read_curve
from fungrasp.training.settings import CurveSettings, Variety
from fungrasp.training.train import HELD_OUT_PLANS, train
from fungrasp.training.training_sets import TrainingSet, split_sets


def run(folder: Path, updates: int, curve: CurveSettings | None, **ppo) -> dict:
    trained(folder, run_spec(updates * BATCH, curve, **ppo))
    return read_checkpoint(folder / "checkpoint.pt")


@pytest.mark.parametrize("sees", ["contacts", pytest.param("history", marks=pytest.mark.slow)])
def test_a_training_does_not_notice_its_curve_which_goes_on_from_a_checkpoint(tmp_path, sees):
    curve, file = CurveSettings(every=BATCH), tmp_path / "with" / CURVE
    without = run(tmp_path / "without", 2, None, sees=sees)
    measured = run(tmp_path / "with", 2, curve, sees=sees)
    assert without["random"] == measured["random"]
    for part in ("actor_state_dict", "critic_state_dict"):
        for name, value in without[part].items():
            assert torch.equal(value, measured[part][name]), name
    before = read_curve(file)
    assert before[0].success == 1.0, "hardly trained, it plays the plan, which holds a can and a ball"
    assert 0.3 < before[0].contact_ratio <= 1 and 0 < before[0].slip_mm_s < 50
    assert not (tmp_path / "without" / CURVE).exists()
    # A point after the checkpoint is dropped.
    file.write_text(f"{file.read_text()}{9 * BATCH},1.0,0.5,0.5,0.5,nan\n")
    assert np.isnan(read_curve(file)[-1].slip_mm_s)
    run(tmp_path / "with", 3, replace(curve, every=2 * BATCH), sees=sees)
    after = read_curve(file)
    assert after[:2] == before and [point.steps for point in after] == [BATCH, 2 * BATCH, 3 * BATCH]
    assert after[1].seconds < after[2].seconds
    file.write_text("steps\nmany\n")
    with pytest.raises(FungraspError, match=r"curve.csv is damaged, or not a learning curve$"):
        run(tmp_path / "with", 4, curve, sees=sees)


def test_some_of_many_grasps_are_measured_the_same_in_every_training(monkeypatch, tmp_path):
    monkeypatch.setattr(learning_curve, "GRASPS", 1)

    def chosen(seed: int, of_training: int) -> np.ndarray:
        worlds = environment(of_training)
        curve = LearningCurve(tmp_path, library(), training_set().objects, worlds, 1, seed)
        return curve.plans.object_name

    assert {str(chosen(seed, 0)[0]) for seed in range(6)} == {"can", "tennis_ball"}
    for seed in range(3):
        assert chosen(seed, 0).tolist() == chosen(seed, 1).tolist()


def test_held_out_grasps_are_measured_and_not_trained_on(tmp_path):
    curve = CurveSettings(every=BATCH, held_out=0.5)
    card = trained(tmp_path, run_spec(curve=curve))
    assert card.training_data[0].count == 1
    learned, held = (
        str(np.load(tmp_path / name)["object_name"][0]) for name in ("plans.npz", HELD_OUT_PLANS)
    )
    assert {learned, held} == {"can", "tennis_ball"}
    assert len(read_curve(tmp_path / CURVE)) == 1
    with pytest.raises(FungraspError, match="sets is "):
        trained(tmp_path)
    with pytest.raises(FungraspError, match=r"two grasps: 0.1 of its 2 grasps can't be held out"):
        split_sets([training_set()], 0.1, 0)


def test_held_out_grasps_are_measured_even_if_their_plans_do_not_hold(tmp_path):
    human = builtin_grasps().select(np.array([54, 54]))
    objects = load_objects(human)
    grasps = retarget(human, objects, hand(), threads=1)
    grasps.wrist_pose[1, :3] += 0.3  # This seed holds out the second grasp.
    sets = [TrainingSet("two grasps", grasps, objects, "free")]
    spec = run_spec(curve=CurveSettings(every=BATCH, held_out=0.5, seed=3))
    train(tmp_path, sets, hand(), replace(spec, variety=Variety(copies=1, held=True)))
    with np.load(tmp_path / HELD_OUT_PLANS) as held:
        assert len(held["object_name"]) == 1


def test_every_grasp_is_on_one_side_of_the_split():
    one = training_set()
    many = replace(
        one, grasps=replace(one.grasps.select(np.arange(10) % 2), object_mass=np.arange(1.0, 11.0))
    )
    learned, held = (part[0].grasps.object_mass for part in split_sets([many], 0.3, 4))
    assert len(held) == 3 and sorted([*learned, *held]) == list(range(1, 11))


@pytest.mark.parametrize(
    "wrong", [{"every": -1}, {"held_out": 1.0}, {"seed": -1}, {"every": 0, "held_out": 0.2}]
)
def test_impossible_curves(wrong):
    with pytest.raises(FungraspError, match="curve"):
        CurveSettings(**wrong)


def test_a_curve_is_drawn():
    nan = float("nan")
    points = np.array([(10, 1.0, 0.5, 0.1, 0.2, nan), (20, 2.0, 1.0, 0.2, 0.4, 3.0)])
    drawing = ElementTree.fromstring(curve_svg(points))
    texts = {text.text for text in drawing.iter("{http://www.w3.org/2000/svg}text")}
    assert {
        "success",
        "held as shown",
        "contact ratio",
        "slip [mm/s]",
        "control steps [millions]",
        "time [min]",
    } <= texts
