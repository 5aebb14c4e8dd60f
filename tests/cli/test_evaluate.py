"""The command ``fungrasp evaluate``."""

from __future__ import annotations

import json

import numpy as np
import pytest
from grasp_files import BAD, bad_inputs, run, some_grasps
from PIL import Image

from fungrasp.evaluation import dynamic, replay
from fungrasp.grasps import save_human_grasps


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    return bad_inputs(tmp_path_factory.mktemp("bad"))


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
    status, out, err = run(
        capsys,
        "evaluate",
        "--grasps",
        human,
        "--json",
        one,
        "--record",
        record,
        "--picture",
        picture,
        "--seed",
        0,
    )
    assert status == 0 and err == ""
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["object", "trials", "success"]
    assert [line.split()[0] for line in lines[1:5]] == ["can", "tennis_ball", "all", "mean"]
    assert "95 % interval" in lines[0] and "2 trials in" in lines[-1]
    assert (
        run(capsys, "evaluate", "--grasps", robot, "--json", two, "--policy", "reference", "--threads", 1)[0]
        == 0
    )
    assert trials(one) == trials(two)
    numbers = json.loads(one.read_text())
    for key in (
        "version",
        "success_rate",
        "success_interval",
        "contact_f1",
        "by_object",
        "seconds",
        "machine",
    ):
        assert key in numbers
    assert sorted(path.name for path in record.iterdir()) == ["0000_can.npz", "0001_tennis_ball.npz"]
    assert replay(record / "0000_can.npz").success == trials(one)[0]["success"]
    with Image.open(picture) as image:
        assert np.asarray(image.convert("RGB")).std() > 10
    assert {path.name for path in tmp_path.iterdir()} == {"one.json", "two.json", "trials", "p.png"}


def test_methods_side_by_side(human, tmp_path, capsys):
    path = tmp_path / "e.json"
    status, out, _ = run(
        capsys, "evaluate", "--grasps", human, "--method", "ours", "angle-copy", "--json", path, "--static"
    )
    assert status == 0
    assert [line.split()[0] for line in out.splitlines()[-4:-1]] == ["method", "ours", "angle-copy"]
    assert out.count("six directions:") == 2 and out.count("contact gap") == 2
    methods = json.loads(path.read_text())["methods"]
    assert list(methods) == ["ours", "angle-copy"]
    assert {"six_directions", "quality", "trials"} <= set(methods["ours"])


def test_refined_grasps_are_no_worse(human, tmp_path, capsys):
    plain, refined = tmp_path / "plain.json", tmp_path / "refined.json"
    assert run(capsys, "evaluate", "--grasps", human, "--json", plain)[0] == 0
    assert run(capsys, "evaluate", "--grasps", human, "--refine", 2, "--json", refined)[0] == 0
    before, after = ([trial["success"] for trial in trials(path)] for path in (plain, refined))
    assert all(b <= a for b, a in zip(before, after, strict=True))
    assert all(abs(trial["refined_tries"]) <= 2 for trial in trials(refined))


def test_disturbances_and_seeds(human, tmp_path, capsys):
    path = tmp_path / "e.json"
    options = ("--mass-scale", 2, "--friction", 0.6, "--pose-noise", 0.01, 10, "--table-height", 0.02)
    status, out, _ = run(capsys, "evaluate", "--grasps", human, "--seed", 0, 1, *options, "--json", path)
    assert status == 0 and "4 trials" in out
    numbers = json.loads(path.read_text())
    assert numbers["seed"] == [0, 1]
    assert numbers["disturbance"]["rotation_noise"] == pytest.approx(np.deg2rad(10))
    assert [(trial["index"], trial["seed"]) for trial in numbers["trials"]] == [
        (0, 0),
        (1, 0),
        (0, 1),
        (1, 1),
    ]


def test_an_interrupted_run_goes_on_when_given_again(human, tmp_path, capsys, monkeypatch):
    path = tmp_path / "e.json"
    monkeypatch.setattr(dynamic, "CHUNK", 1)
    simulate, runs = dynamic._Test.run, []

    def interrupted(self, grasps, rows, *others):
        if runs:
            raise KeyboardInterrupt
        runs.append(rows)
        return simulate(self, grasps, rows, *others)

    monkeypatch.setattr(dynamic._Test, "run", interrupted)
    status, _, err = run(capsys, "evaluate", "--grasps", human, "--json", path)
    assert status == 130 and err == "fungrasp: interrupted\n"
    assert [file.name for file in tmp_path.iterdir()] == ["e.json.partial"]

    def counted(self, grasps, rows, *others):
        runs.append(rows)
        return simulate(self, grasps, rows, *others)

    monkeypatch.setattr(dynamic._Test, "run", counted)
    assert run(capsys, "evaluate", "--grasps", human, "--json", path)[0] == 0
    assert [rows.tolist() for rows in runs] == [[0], [1]]
    assert [file.name for file in tmp_path.iterdir()] == ["e.json"]
    assert run(capsys, "evaluate", "--grasps", human, "--json", tmp_path / "f.json")[0] == 0
    assert trials(path) == trials(tmp_path / "f.json")


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_leaves_no_file(name, bad, tmp_path, capsys):
    arguments, words = bad[name]
    status, out, err = run(
        capsys, "evaluate", *arguments, "--json", tmp_path / "e.json", "--record", tmp_path / "trials"
    )
    assert status == 2 and out == ""
    assert err.startswith("fungrasp: error: ") and err.count("\n") == 1 and words in err, err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--policy", "referee"), "Did you mean 'reference'?"),
        (("--hand", "leap"), "of the hand 'allegro', not of 'leap'"),
        (("--method", "angle-copy"), "holds robot grasps already"),
        (("--seed", 0, 1), "nothing is random here"),
        (("--seed", 1, 1), "each once"),
        (("--seed", -1), "must not be negative"),
        (("--refine", -1), "must not be negative"),
        (("--mass-scale", 0), "mass scale must be positive"),
        (("--pose-noise", "nan", 0), "position noise must be finite"),
        (("--friction", -0.5), "friction must be positive"),
    ],
)
def test_options_that_cannot_be(arguments, words, robot, tmp_path, capsys):
    status, out, err = run(capsys, "evaluate", "--grasps", robot, *arguments, "--json", tmp_path / "e.json")
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err, err
    assert list(tmp_path.iterdir()) == []
