"""The benchmarks' commands."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from benchmark_runs import run_benchmark
from grasp_files import some_grasps

from benchmarks import speed
from fungrasp.grasps import save_human_grasps
from fungrasp.planning.selection.settings import SelectionSettings


@pytest.fixture(scope="module")
def human(tmp_path_factory):
    path = tmp_path_factory.mktemp("grasps") / "g.npz"
    save_human_grasps(path, some_grasps())
    return path


def test_speeds_are_measured_and_planning_with_and_without_rollouts(human, tmp_path, capsys, monkeypatch):
    def few(protocol, rollouts=True, for_use=False, other_places=False):
        small = SelectionSettings(candidates=2, confirmations=1, searches=0, more_searches=0)
        return small if rollouts else replace(small, rollouts=None)

    monkeypatch.setattr(SelectionSettings, "for_protocol", few)
    path = tmp_path / "b.json"
    options = ["--planned", "1", "--worlds", "2", "--updates", "1", "--repeat", "1", "--json"]
    status, out, _ = run_benchmark(capsys, "speed", "--grasps", human, *options, path)
    assert status == 0 and "core s/grasp" in out
    speed = json.loads(path.read_text())["speed"]
    assert len(speed) == 9 and all(value > 0 for value in speed.values())
    with_rollouts, alone = (value for name, value in speed.items() if name.startswith("planning"))
    assert with_rollouts > alone


def test_whole_commands_are_timed_cold_and_warm(tmp_path, capsys, monkeypatch):
    some = {name: speed.COMMANDS[name] for name in ("import", "hands list")}
    made = {"check": ("hands.adding.add_hand:check_hand_files", "hands check allegro")}
    monkeypatch.setattr(speed, "COMMANDS", some | made)
    path = tmp_path / "b.json"
    status, out, _ = run_benchmark(capsys, "speed", "commands", "--repeat", 1, "--json", path)
    assert status == 0 and "hands list" in out
    found = json.loads(path.read_text())["commands"]
    assert all(one["cold"] > 0 and one["wall"] > 0 and one["cpu"] > 0 for one in found.values())
    assert found["import"]["verb"] == 0 < found["check"]["verb"] < found["check"]["wall"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("speed", "--repeat", 0), "--repeat must be at least 1"),
        (("gpu", "--worlds", 0), "--worlds must be at least 1"),
        (("gpu", "--hand", "alegro"), "Did you mean 'allegro'?"),
        (("engines", "speed"), "Known: audit"),
        (("speed", "--grasps", "none.npz"), "none.npz does not exist"),
    ],
)
def test_mistakes_are_one_line(arguments, words, capsys):
    status, out, err = run_benchmark(capsys, *arguments)
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err
