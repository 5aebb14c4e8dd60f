"""The command ``fungrasp evaluate``."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from grasp_files import check_bad_inputs, run, some_grasps
from PIL import Image

from fungrasp.core.jobs import PartStore
from fungrasp.evaluation import lift_episodes, lift_evaluation, replay
from fungrasp.grasps import save_human_grasps
from fungrasp.sim2real import NOMINAL, MeasurementError, Randomization


@pytest.fixture(scope="module")
def human(tmp_path_factory):
    path = tmp_path_factory.mktemp("grasps") / "g.npz"
    save_human_grasps(path, some_grasps())
    return path


@pytest.fixture(scope="module")
def robot(human):
    from fungrasp.cli.main import main

    path = human.with_name("r.npz")
    assert main(["retarget", "--grasps", str(human), "--out", str(path)]) == 0
    return path


def trials(path) -> list[dict]:
    return json.loads(path.read_text())["trials"]


def test_human_and_robot_grasps_give_the_same_table_and_json(human, robot, tmp_path, capsys):
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    record, picture = tmp_path / "trials", tmp_path / "p.png"
    written = ("--json", one, "--record", record, "--picture", picture)
    status, out, err = run(capsys, "evaluate", "--grasps", human, *written, "--seed", 0)
    assert status == 0 and err == ""
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["object", "episodes", "held"]
    assert [line.split()[0] for line in lines[1:5]] == ["can", "tennis_ball", "all", "mean"]
    assert "95 % interval" in lines[0] and "2 episodes in" in lines[-2] and f"view {one}" in lines[-1]
    assert (
        run(capsys, "evaluate", "--grasps", robot, "--json", two, "--policy", "reference", "--threads", 1)[0]
        == 0
    )
    assert trials(one) == trials(two)
    numbers = json.loads(one.read_text())
    assert {"success_interval", "contact_f1", "by_object", "mujoco", "date", "revision"} <= set(numbers)
    assert sorted(path.name for path in record.iterdir()) == ["0000_can.npz", "0001_tennis_ball.npz"]
    assert replay(record / "0000_can.npz").success == trials(one)[0]["success"]
    with Image.open(picture) as image:
        assert np.asarray(image.convert("RGB")).std() > 10
    assert {path.name for path in tmp_path.iterdir()} == {"one.json", "two.json", "trials", "p.png"}


def test_another_method_and_its_static_quality(human, tmp_path, capsys):
    path = tmp_path / "e.json"
    options = ("--method", "angle-copy", "--no-adapt", "--static", "--json", path)
    status, out, _ = run(capsys, "evaluate", "--grasps", human, *options)
    assert status == 0 and "contact gap" in out
    numbers = json.loads(path.read_text())
    assert numbers["quality"]["contact_gap_mm"]["mean"] > 0 and numbers["spec"]["adapt"] is False


def test_conditions_and_seeds(human, tmp_path, capsys):
    path = tmp_path / "e.json"
    options = ("--mass-scale", 2, "--friction", 0.6, "--pose-noise", 0.01, 10, "--table-height", 0.02)
    options += ("--latency", 0.04, "--push", 0.5, 0.1, "--object-shift", 0.01)
    status, out, _ = run(capsys, "evaluate", "--grasps", human, "--seed", 0, 1, *options, "--json", path)
    assert status == 0 and "4 episodes" in out
    numbers = json.loads(path.read_text())
    assert numbers["seed"] == [0, 1]
    told = {
        name: value
        for name, value in numbers["randomization"].items()
        if value != json.loads(json.dumps(dataclasses.asdict(NOMINAL)))[name]
    }
    none = dataclasses.asdict(MeasurementError())
    rotation = told.pop("object_rotation_error")
    assert rotation == none | {"offset": pytest.approx(np.deg2rad(10))}
    assert told == {
        "mass": [2.0, 2.0],
        "friction": [0.6, 0.6],
        "object_position_error": none | {"offset": 0.01},
        "table_height": [0.02, 0.02],
        "action_delay": [0.04, 0.04],
        "push_times": [[0.5, 0.5], [1.5, 1.5], [2.5, 2.5]],
        "push_weights": [0.5, 0.5],
        "push_duration": 0.1,
        "object_shift": [0.01, 0.01],
    }
    assert [(trial["index"], trial["seed"]) for trial in numbers["trials"]] == [
        (0, 0),
        (1, 0),
        (0, 1),
        (1, 1),
    ]


SOME = {
    "nominal": NOMINAL,
    "light, moved": Randomization(mass=(0.7, 0.7), object_shift=(0.01, 0.01)),
    "latency 60 ms": Randomization(action_delay=(0.06, 0.06)),
}


def test_robustness_tries_every_condition(human, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fungrasp.sim2real.randomization.ROBUSTNESS", SOME)
    path, plain, record = tmp_path / "r.json", tmp_path / "e.json", tmp_path / "trials"
    options = ("--grasps", human, "--seed", 0, 1, "--protocol", "robustness")
    options += ("--json", path, "--record", record)
    status, out, _ = run(capsys, "evaluate", *options)
    assert status == 0
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["condition", "episodes", "held"]
    assert [line.split("  ")[0] for line in lines[1:4]] == list(SOME)
    # What is not random is tried once.
    assert [line.replace(name, "").split()[0] for line, name in zip(lines[1:4], SOME, strict=True)] == list(
        "242"
    )
    numbers = json.loads(path.read_text())
    conditions = numbers["robustness"]
    assert numbers["protocol"] == "robustness"
    assert list(conditions) == list(SOME)
    rates = [condition["success_rate"] for condition in conditions.values()]
    shown = [condition["held_as_shown"] for condition in conditions.values()]
    mean = f"success {(rates[1] + rates[2]) / 2:.1%}, held as shown {(shown[1] + shown[2]) / 2:.1%}"
    assert lines[4] == f"mean over the 2 disturbed conditions: {mean}"
    assert "8 episodes in" in lines[5]
    assert conditions["light, moved"]["randomization"]["object_shift"] == [0.01, 0.01]
    moved = conditions["light, moved"]["trials"]
    assert [(trial["index"], trial["seed"]) for trial in moved] == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert np.mean([trial["success"] for trial in moved]) == rates[1]
    assert sorted(folder.name for folder in record.iterdir()) == ["latency-60-ms", "light-moved", "nominal"]
    assert len(list((record / "light-moved").iterdir())) == 4
    assert run(capsys, "evaluate", "--grasps", human, "--json", plain)[0] == 0
    assert trials(plain) == numbers["trials"]
    assert conditions["nominal"]["success_rate"] == numbers["success_rate"]


def test_an_interrupted_run_goes_on_when_given_again(human, tmp_path, capsys, monkeypatch):
    path = tmp_path / "e.json"
    monkeypatch.setattr(lift_evaluation, "EPISODES", (1, 1))
    simulate, runs = lift_episodes.LiftTest.simulate, []

    def interrupted(self, chunk, progress):
        if runs:
            raise KeyboardInterrupt
        runs.append(chunk.rows)
        return simulate(self, chunk, progress)

    monkeypatch.setattr(lift_episodes.LiftTest, "simulate", interrupted)
    status, _, err = run(capsys, "evaluate", "--grasps", human, "--json", path)
    assert status == 130 and err.endswith("fungrasp: interrupted\n")
    assert [file.name for file in tmp_path.iterdir()] == ["e.json.partial"]

    def counted(self, chunk, progress):
        runs.append(chunk.rows)
        return simulate(self, chunk, progress)

    monkeypatch.setattr(lift_episodes.LiftTest, "simulate", counted)
    assert run(capsys, "evaluate", "--grasps", human, "--json", path)[0] == 0
    assert [rows.tolist() for rows in runs] == [[0], [1]]
    assert [file.name for file in tmp_path.iterdir()] == ["e.json"]
    assert run(capsys, "evaluate", "--grasps", human, "--json", tmp_path / "f.json")[0] == 0
    assert trials(path) == trials(tmp_path / "f.json")


def test_missing_parts_are_tried_together_and_kept_singly(human, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(lift_evaluation, "EPISODES", (1, 1))
    monkeypatch.setattr(lift_evaluation, "LOSS", 1)
    kept, save = [], PartStore.save

    def counted(self, key, arrays):
        kept.append({name: len(values) for name, values in arrays.items()})
        save(self, key, arrays)

    simulate, runs = lift_episodes.LiftTest.simulate, []

    def run_(self, chunk, progress):
        runs.append(chunk.rows.tolist())
        return simulate(self, chunk, progress)

    monkeypatch.setattr(PartStore, "save", counted)
    monkeypatch.setattr(lift_episodes.LiftTest, "simulate", run_)
    command = ("evaluate", "--grasps", human, "--json")
    assert run(capsys, *command, tmp_path / "together.json")[0] == 0
    assert runs == [[0, 1]] and len(kept) == 2 and all(set(part.values()) == {1} for part in kept)
    monkeypatch.setattr(lift_evaluation, "BATCH", 1)
    assert run(capsys, *command, tmp_path / "singly.json")[0] == 0
    assert runs[1:] == [[0], [1]]
    assert trials(tmp_path / "together.json") == trials(tmp_path / "singly.json")


def test_bad_input_is_one_line_and_leaves_no_file(tmp_path, tmp_path_factory, capsys):
    written = ("--json", tmp_path / "e.json", "--record", tmp_path / "trials")
    check_bad_inputs(tmp_path_factory.mktemp("bad"), capsys, "evaluate", *written)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--policy", "referee"), "Did you mean 'reference'?"),
        (("--hand", "leap"), "of the hand 'allegro', not of 'leap'"),
        (("--method", "angle-copy"), "has robot grasps"),
        (("--seed", 0, 1), "nothing is random here"),
        (("--attempts", 2), "an open-loop policy can't notice that it failed"),
        (("--attempts", 2, "--policy", "plan"), "an open-loop policy can't notice that it failed"),
        (("--attempts", 0), "there must be 1 attempt or more, not 0"),
        (("--attempts", 2, "--policy", "student", "--record", "r"), "only one attempt is recorded"),
        (("--seed", 1, 1), "each once"),
        (("--seed", -1), "must not be negative"),
        (("--mass-scale", 0), "mass must be positive"),
        (("--pose-noise", "nan", 0), "pose_noise[0]: expected a finite number, not nan"),
        (("--friction", -0.5), "friction must be positive"),
        (("--latency", 0.2), "action delay must be 0 to 0.1 s"),
        (("--push", -1, 0.2), "push weights must not be negative"),
        (("--push", 1, 0), "push duration must be positive"),
        (("--object-shift", "inf"), "object_shift: expected a finite number, not inf"),
        (("--protocol", "reality", "--mass-scale", 2), "the protocol reality already defines"),
    ],
)
def test_options_that_cannot_be(arguments, words, robot, tmp_path, capsys):
    status, out, err = run(capsys, "evaluate", "--grasps", robot, *arguments, "--json", tmp_path / "e.json")
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err, err
    assert list(tmp_path.iterdir()) == []
