"""The commands ``fungrasp train``, ``distill`` and ``reproduce``: mistakes are one line."""

from __future__ import annotations

import json

import pytest
from grasp_files import run, some_grasps

from fungrasp.cli import reproduce_policies
from fungrasp.cli.reproduce import HandsTable
from fungrasp.cli.sweep import each_training
from fungrasp.cli.train import Train
from fungrasp.evaluation.result_files import read_result
from fungrasp.evaluation.tables import CONDITIONS
from fungrasp.grasps import save_human_grasps
from fungrasp.sim2real import MODERATE, REALITY

TABLE = ("--grasps", "builtin", "--test", "builtin")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("train", "--steps", 0), "--steps must be at least 1"),
        (("train", "--seed", -1), "must not be negative"),
        (("train", "--hand", "alegro"), "Did you mean 'allegro'?"),
        (("train", "--method", "our"), "Did you mean 'ours'?"),
        (("train", "--grasps", "none.npz"), "none.npz does not exist"),
        (("train", "--grasps", "builtin", "builtin"), "each once"),
        (("train", "--terms", "a", "b"), "one text for each of the 1 --grasps, not 2"),
        (("train", "--sweep", "ppo.noise"), "SETTING=VALUE,VALUE..."),
        (("train", "--sweep", "ppo.nose=1,2"), "Did you mean 'ppo.noise'?"),
        (("train", "--sweep", "ppo.noise=0.1,much"), "'much' is no value of ppo.noise"),
        (("train", "--sweep", "ppo.noise=0.1,0.1"), "each value once"),
        (("train", "--sweep", "ppo.noise=1,2", "ppo.noise=3"), "each setting once"),
        (("train", "--sweep", "hand=a/x.toml,b/x.toml"), "two trainings would be kept"),
        (("train", "--sweep", "steps=10,0"), "--steps must be at least 1"),
        (("distill", "--teacher", "nowhere"), "nowhere is not the folder of a training"),
        (("reproduce", "policies", "--hands", "alegro"), "Did you mean 'allegro'?"),
        (("reproduce", "policies", "--grasp-seeds", -1), "must not be negative"),
        (("reproduce", "privileged", *TABLE, "--rollouts"), "give --plans too"),
        (("reproduce", "hands", *TABLE, "--seeds", 1, 1), "--seeds must be different ones"),
    ],
)
def test_mistakes_are_one_line(arguments, words, tmp_path, capsys):
    status, out, err = run(capsys, *arguments, "--out", tmp_path / "out")
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err
    assert not (tmp_path / "out" / "checkpoint.pt").exists()


def test_wandb_is_asked_for_in_words(tmp_path, capsys):
    pytest.importorskip("torch")
    try:
        import wandb  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError:
        pass
    else:
        pytest.skip("wandb is installed")
    status, _, err = run(capsys, "train", "--out", tmp_path, "--wandb", "project")
    assert status == 2 and "pip install wandb" in err


def test_a_sweep_is_every_combination_with_every_seed(tmp_path):
    sweep = ("ppo.hidden=64,32 16", "sees=nothing,contacts", "environment.history=True")
    each = each_training(Train(tmp_path, seeds=(3, 5), sweep=sweep, shrink=0.5))
    assert len(each) == 2 * 2 * 2 and all(one.sweep == one.seeds == () for one in each)
    last = each[-1]
    assert last.out == tmp_path / "ppo.hidden=32-16,sees=contacts,environment.history=True" / "seed-5"
    assert (last.ppo.hidden, last.sees, last.environment.history) == ((32, 16), "contacts", True)
    assert (last.seed, last.shrink, last.ppo.noise) == (5, 0.5, Train(tmp_path).ppo.noise)
    assert [one.out for one in each_training(Train(tmp_path, seeds=(7,)))] == [tmp_path / "seed-7"]


def test_worlds_can_be_named_by_what_they_are_drawn_from(tmp_path, monkeypatch):
    pytest.importorskip("rsl_rl")
    import fungrasp.training.run as training

    class Enough(Exception):
        pass

    asked = []

    def stand_in(out, sets, hand, settings, *others, **more):
        asked.append(settings.environment)
        raise Enough

    monkeypatch.setattr(training, "train", stand_in)
    grasps = tmp_path / "g.npz"
    save_human_grasps(grasps, some_grasps())
    for worlds in ("reality", None):
        with pytest.raises(Enough):
            Train(tmp_path / "out", (str(grasps),), worlds=worlds).run()
    assert [one.randomization for one in asked] == [REALITY, MODERATE]


def test_finished_variants_are_not_trained_again_unless_settings_differ(tmp_path, capsys):
    pytest.importorskip("rsl_rl")
    grasps = tmp_path / "g.npz"
    save_human_grasps(grasps, some_grasps())
    kept = tmp_path / "allegro" / "seed-0" / "dexgraspnet.json"
    kept.parent.mkdir(parents=True)
    kept.write_text(json.dumps({"budget": {}, "results": {}}))
    common = ("--grasps", grasps, "--test", grasps, "--out", tmp_path)
    status, _, err = run(capsys, "reproduce", "retargeting", *common)
    assert status == 2 and "was made with other settings" in err
    kept.write_text("{")
    status, _, err = run(capsys, "reproduce", "retargeting", *common)
    assert status == 2 and "is damaged" in err


def test_a_table_is_made_of_all_seeds_and_conditions_and_kept(tmp_path, capsys, monkeypatch):
    pytest.importorskip("rsl_rl")
    grasps = tmp_path / "g.npz"
    save_human_grasps(grasps, some_grasps())
    tested = []

    def stand_in(options, variant, hand, policy, seed):
        tested.append((hand.name, variant.name, seed))
        trial = {"object": "mug", "reason": "", "contact_ratio": 0.5, "sim_distance_hand_mm_s": 1.0}
        success = [True, seed == 0 and hand.name != "shadow"]
        trials = [{**trial, "index": index, "success": done} for index, done in enumerate(success)]
        return {name: {"trials": trials, "success_rate": sum(success) / 2} for name in CONDITIONS}

    monkeypatch.setattr(HandsTable, "_trained", lambda *_: tmp_path / "policy.onnx")
    monkeypatch.setattr(HandsTable, "_tested", stand_in)
    command = ("reproduce", "hands", "--grasps", grasps, "--test", grasps, "--seeds", 0, 4)
    status, out, err = run(capsys, *command, "--out", tmp_path / "out")
    assert status == 0, err
    assert tested == [(hand, "student", seed) for seed in (0, 4) for hand in ("shadow", "faive", "allegro")]
    result = read_result(tmp_path / "out" / "hands.json")
    rates = [one["conditions"]["reality"]["success_rate"] for one in result.header["policies"]]
    assert rates == [0.5, 0.75, 0.75] and len(result.rows) == 3 * 2 * len(CONDITIONS) * 2
    assert "Shadow" in out and "75.0%" in out
    again = run(capsys, *command, "--out", tmp_path / "out")
    assert again[0] == 0 and len(tested) == 6, "nothing is tested twice"


def test_free_policies_are_trained_in_turn_and_only_where_they_are_missing(tmp_path, capsys, monkeypatch):
    pytest.importorskip("rsl_rl")
    made = []

    def stand_in(name, file):
        def run_(command):
            made.append(name)
            path = command.out / file if file else command.out
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(name)

        return run_

    kinds = {"MakeGrasps": "", "TrainPredictor": "", "Train": "policy.onnx", "Distill": "student.onnx"}
    for name, file in kinds.items():
        monkeypatch.setattr(getattr(reproduce_policies, name), "run", stand_in(name, file))
    command = ("reproduce", "policies", "--hands", "leap", "--grasp-seeds", 1, "--out", tmp_path)
    status, _, err = run(capsys, *command)
    assert status == 0, err
    assert made == list(kinds)
    files = {path.name: path.read_text() for path in (tmp_path / "policies").iterdir()}
    assert files == {
        "leap-predictor-free.onnx": "TrainPredictor",
        "leap-teacher-free.onnx": "Train",
        "leap-student-free.onnx": "Distill",
    }
    made.clear()
    run(capsys, *command)
    assert made == ["Train"], "which goes on by its checkpoint"
