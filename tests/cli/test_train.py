"""The commands ``fungrasp train``, ``distill`` and ``reproduce``: mistakes are one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from grasp_files import run, some_grasps

from fungrasp.cli.train import Train
from fungrasp.grasps import load_objects, save_human_grasps, save_robot_grasps
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget
from fungrasp.sim2real import MODERATE, REALITY


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("train", "--steps", 0), "steps must be at least 1"),
        (("train", "--seed", -1), "must not be negative"),
        (("train", "--hand", "alegro"), "Did you mean 'allegro'?"),
        (("train", "--method", "contakt"), "Did you mean 'contact'?"),
        (("train", "--grasps", "none.npz"), "none.npz does not exist"),
        (("train", "--grasps", "builtin", "builtin"), "each once"),
        (("train", "--worlds", "realty"), "unknown preset of worlds 'realty'. Did you mean 'reality'?"),
        (("train", "--environment.worlds", 0), "at least one world, not 0"),
        (("train", "--environment.early", 9, 4), "not 9 to 4"),
        (("train", "--environment.whole", 2), "from 0 to 1, not 2"),
        (("train", "--environment.widen", 9, 4), "to a later one, not 9 to 4"),
        (("train", "--ppo.imitate", 100), "needs environment.residual.base 'guided'"),
        (("train", "--terms", "a", "b"), "one text for each of the 1 --grasps, not 2"),
        (("distill", "--teacher", "nowhere"), "nowhere is not the folder of a training"),
    ],
)
def test_mistakes_are_one_line(arguments, words, tmp_path, capsys):
    status, out, err = run(capsys, *arguments, "--out", tmp_path / "out")
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err
    assert not (tmp_path / "out" / "checkpoint.pt").exists()


def test_grasps_of_another_hand_are_named(tmp_path, capsys):
    pytest.importorskip("rsl_rl")
    human = some_grasps(("can",))
    grasps = tmp_path / "leap.npz"
    save_robot_grasps(grasps, retarget(human, load_objects(human), load_hand("leap"), threads=1))
    status, out, err = run(capsys, "train", "--grasps", grasps, "--out", tmp_path / "out")
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert err.endswith("leap.npz: the grasps are of the hand 'leap', not of 'allegro'\n")


def test_what_differs_from_an_interrupted_training_is_named(tmp_path, capsys):
    pytest.importorskip("rsl_rl")
    human = some_grasps(("can",))
    grasps, out = tmp_path / "g.npz", tmp_path / "out"
    save_robot_grasps(grasps, retarget(human, load_objects(human), load_hand("allegro"), threads=1))
    small = ("--environment.worlds", 4, "--ppo.steps", 2, "--ppo.warm-up", 1, "--ppo.hidden", 8, 8)
    command = ("train", "--grasps", grasps, "--out", out, "--threads", 1, "--variety.copies", 1, *small)
    assert run(capsys, *command, "--steps", 8, "--curve.every", 0)[0] == 0
    for others, words in (
        (("--ppo.gamma", 0.9), "ppo.gamma is 0.99 there, 0.9 here"),
        (("--layout", "paper"), 'environment.layout is "full" there, "paper" here'),
        (("--worlds", "nominal"), "environment.randomization."),
        (("--seed", 3), "seed is 0 there, 3 here"),
    ):
        status, _, err = run(capsys, *command, "--steps", 16, *others)
        assert status == 2 and err.count("\n") == 1 and words in err and str(out) in err


def test_worlds_can_be_named_by_what_they_are_drawn_from(tmp_path, monkeypatch):
    pytest.importorskip("rsl_rl")
    import fungrasp.training.train as training

    class Enough(Exception):
        pass

    asked = []

    def stand_in(out, sets, hand, spec, **more):
        asked.append(spec.environment)
        raise Enough

    monkeypatch.setattr(training, "train", stand_in)
    grasps = tmp_path / "g.npz"
    save_human_grasps(grasps, some_grasps())
    for worlds in ("reality", None):
        with pytest.raises(Enough):
            Train(out=tmp_path / "out", grasps=(str(grasps),), worlds=worlds).run()
    assert [one.randomization for one in asked] == [REALITY, MODERATE]


def test_a_training_has_a_folder_of_its_own_if_none_is_given():
    assert Train(hand="claws/claw.toml").folder == Path("runs/claw")
