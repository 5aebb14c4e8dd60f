"""The benchmarks' commands."""

from __future__ import annotations

import json

import pytest
from benchmark_runs import run_benchmark
from grasp_files import some_grasps

from fungrasp.grasps import save_human_grasps
from fungrasp.planning.selection import SelectionSettings
from fungrasp.planning.selection.settings import FurtherSearch


@pytest.fixture(scope="module")
def human(tmp_path_factory):
    path = tmp_path_factory.mktemp("grasps") / "g.npz"
    save_human_grasps(path, some_grasps())
    return path


def test_retargeting_side_by_side(human, tmp_path, capsys):
    path = tmp_path / "b.json"
    status, out, _ = run_benchmark(
        capsys, "speed", "retarget", "--grasps", human, "--repeat", 1, "--json", path
    )
    assert status == 0
    methods = json.loads(path.read_text())["methods"]
    assert {"contact", "angle-copy", "dexgraspnet"} <= set(methods)
    for name, numbers in methods.items():
        assert numbers["grasps_per_second"] > 0 and "contact_error_mm" in numbers["quality"]
        assert name in out


def test_planning_counts_core_seconds_with_and_without_rollouts(human, tmp_path, capsys, monkeypatch):
    def few(protocol, rollouts=True, for_use=False):
        further = FurtherSearch(most=0)
        small = SelectionSettings(candidates=2, sure=0.0, first_rounds=((2, 1),), search=further)
        return small if rollouts else SelectionSettings(candidates=2, rollouts=None)

    monkeypatch.setattr(SelectionSettings, "for_protocol", few)
    path = tmp_path / "b.json"
    options = ("--grasps", human, "--number", 1, "--protocol", "reality", "--json", path)
    status, out, _ = run_benchmark(capsys, "speed", "planning", *options)
    assert status == 0 and "core seconds per grasp" in out
    planning = json.loads(path.read_text())["planning"]
    assert planning["with rollouts"]["rollouts_per_grasp"] == 2
    assert planning["predictor alone"]["rollouts_per_grasp"] == 0
    assert (
        planning["with rollouts"]["seconds_per_grasp"] > planning["predictor alone"]["seconds_per_grasp"] > 0
    )
    assert 0 < planning["with rollouts"]["expected_success"] < 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("speed", "retarget", "--method", "contakt"), "Did you mean 'contact'?"),
        (("speed", "retarget", "--repeat", 0), "--repeat must be at least 1"),
        (("engines", "speed", "--worlds", 0), "--worlds must be at least 1"),
        (("engines", "speed", "--hand", "alegro"), "Did you mean 'allegro'?"),
        (("speed", "retarget", "--grasps", "none.npz"), "none.npz does not exist"),
        (("speed", "retargeting"), "Did you mean 'retarget'?"),
    ],
)
def test_mistakes_are_one_line(arguments, words, capsys):
    status, out, err = run_benchmark(capsys, *arguments)
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err
