"""The benchmarks' commands."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmark_runs import run_benchmark
from grasp_files import some_grasps

from benchmarks.perception.capture_files import write_capture
from benchmarks.perception.capture_job import CaptureJob, CaptureTrial
from benchmarks.perception.captures import Captures
from benchmarks.perception.chain import run_chain
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.render_capture import capture_at
from fungrasp.grasps import load_objects, save_human_grasps
from fungrasp.hands import load_hand
from fungrasp.perception import Intrinsics
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


def test_simulation_is_the_same_motion_in_all_three_ways(human, tmp_path, capsys):
    path = tmp_path / "b.json"
    status, out, _ = run_benchmark(
        capsys, "engines", "--grasps", human, "--worlds", 4, "--repeat", 1, "--json", path
    )
    assert status == 0
    numbers = json.loads(path.read_text())
    assert numbers["identical"] and "the same motion" in out and "NOT" not in out
    assert numbers["worlds"] == 4 and numbers["steps"] > 4 * 1000
    assert min(numbers[way] for way in ("environment", "bare", "loop")) > 0
    assert numbers["environment_over_bare"] == pytest.approx(numbers["environment"] / numbers["bare"])


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


def interrupted(method, after):
    """The method, that is interrupted after so many calls."""
    calls = []

    def interrupting(*arguments):
        calls.append(arguments)
        if len(calls) > after:
            raise KeyboardInterrupt
        return method(*arguments)

    return interrupting


@pytest.mark.slow
def test_perception_on_kept_captures(human, tmp_path, capsys, monkeypatch):
    small = CaptureSettings(Intrinsics(320, 240, 300, 300, 160, 120), intrinsics_spread=0, clutter=(0, 0))
    grasps = some_grasps()
    objects = load_objects(grasps)
    for i in range(2):
        write_capture(capture_at(i, grasps, objects, 7, small), tmp_path / "kept" / f"7_{i:04d}")
    path = tmp_path / "b.json"
    arguments = ("--grasps", human, "--captures", 2, "--seed", 7, "--keep", tmp_path / "kept")
    arguments += ("--landmarks-noise", 2)
    with monkeypatch.context() as patch:
        patch.setattr(CaptureJob, "_measured", interrupted(CaptureJob._measured, after=1))
        trial = CaptureTrial(7, landmarks_noise=2.0)
        with pytest.raises(KeyboardInterrupt):
            Captures(human, captures=2, keep=tmp_path / "kept", trial=trial, json=path).run()
    assert not path.exists()
    with monkeypatch.context() as patch:
        patch.setattr(CaptureJob, "_measured", interrupted(CaptureJob._measured, after=1))
        status, out, _ = run_benchmark(capsys, "perception", "captures", *arguments, "--json", path)
    assert status == 0, "the first capture is not measured again"
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["b.json"]
    numbers = json.loads(path.read_text())
    assert numbers["captures"] == 2 and sorted(numbers["objects"]) == ["can", "tennis_ball"]
    assert numbers["hand"]["found"]["rate"] == 1
    assert numbers["object_masked"]["right"]["rate"] == 1
    assert {each["object_name"] for each in numbers["each"]} == {"can", "tennis_ball"}
    assert numbers["peak_memory_gb"] > 0.05
    assert "object right, with mask" in out and "wrong meshes accepted: " not in out


def test_several_policies_try_the_same_chain(monkeypatch):
    grasps = some_grasps().select([0])
    results: list[Any] = [
        SimpleNamespace(true=grasps, perceived=grasps, result=SimpleNamespace(sure=True)),
        SimpleNamespace(true=grasps, perceived=None, result=SimpleNamespace(sure=False)),
    ]

    def tried(robot, objects, policy, **others):
        return SimpleNamespace(outcomes=SimpleNamespace(success=np.full(len(robot), policy == "good")))

    monkeypatch.setattr("fungrasp.retargeting.retarget", lambda human, *others, **more: human)
    monkeypatch.setattr("fungrasp.evaluation.evaluate", tried)
    objects, hand = load_objects(some_grasps()), load_hand("allegro")
    figures = run_chain(results, objects, hand, ("poor", "good"))
    assert figures["policy"] == "poor" and figures["true"]["rate"] == 0 and figures["share"] is None
    assert figures["policies"]["good"]["share"] == 0.5
    alone = run_chain(results, objects, hand, ("good",))
    assert alone["perceived_where_sure"]["rate"] == 1 and "policies" not in alone


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("perception", "captures", "--captures", 0), "--captures must be at least 1"),
        (("perception", "captures", "--only", "mugg"), "Did you mean 'mug'?"),
        (("perception", "captures", "--landmarks-noise", -1), "--landmarks-noise must not be negative"),
        (("perception", "captures", "--chain", "--policy", "referense"), "Did you mean 'reference'?"),
        (("speed", "retarget", "--method", "contakt"), "Did you mean 'contact'?"),
        (("speed", "retarget", "--repeat", 0), "--repeat must be at least 1"),
        (("engines", "--worlds", 0), "--worlds must be at least 1"),
        (("engines", "--hand", "alegro"), "Did you mean 'allegro'?"),
        (("speed", "retarget", "--grasps", "none.npz"), "none.npz does not exist"),
        (("speed", "retargeting"), "Did you mean 'retarget'?"),
    ],
)
def test_mistakes_are_one_line(arguments, words, capsys):
    status, out, err = run_benchmark(capsys, *arguments)
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err
