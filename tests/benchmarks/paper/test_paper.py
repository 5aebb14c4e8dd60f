"""Trainings and tests of the paper's tables."""

from __future__ import annotations

import numpy as np
import pytest
from benchmark_runs import run_benchmark
from grasp_files import some_grasps

from benchmarks.paper.__main__ import PaperTable
from benchmarks.paper.variants import (
    CONDITIONS,
    TABLES,
    curves_svg,
    mean_interval,
    paired_tests,
)
from fungrasp.evaluation.result_files import read_result
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.grasps import save_human_grasps

TABLE = ("--grasps", "builtin", "--test", "builtin")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("paper", "hands", *TABLE, "--seeds", -1), "must not be negative"),
        (("paper", "hands", *TABLE, "--seeds", 1, 1), "--seeds must be different ones"),
        (("paper", "privileged", *TABLE, "--only", "techer"), "Did you mean 'teacher'?"),
    ],
)
def test_mistakes_are_one_line(arguments, words, tmp_path, capsys):
    status, out, err = run_benchmark(capsys, *arguments, "--out", tmp_path / "out")
    assert status == 2 and out == "" and err.count("\n") == 1 and words in err


def test_a_table_is_made_of_all_seeds_and_conditions_and_kept(tmp_path, capsys, monkeypatch):
    pytest.importorskip("rsl_rl")
    grasps = tmp_path / "g.npz"
    save_human_grasps(grasps, some_grasps())
    tested = []

    def stand_in(options, variant, hand, policy, seed):
        tested.append((hand.name, variant.name, seed))
        trial = {"object": "mug", "reason": "", "contact_ratio": 0.5, "sim_distance_hand_mm_s": 1.0}
        success = [True, seed == 0 and hand.name != "shadow"]
        trials = [
            {**trial, "index": index, "success": done, "held_as_shown": False}
            for index, done in enumerate(success)
        ]
        return {name: {"trials": trials, "success_rate": sum(success) / 2} for name in CONDITIONS}

    monkeypatch.setattr(PaperTable, "_trained", lambda *_: tmp_path / "policy.onnx")
    monkeypatch.setattr(PaperTable, "_tested", stand_in)
    command = ("paper", "hands", "--grasps", grasps, "--test", grasps, "--seeds", 0, 4)
    status, out, err = run_benchmark(capsys, *command, "--out", tmp_path / "out")
    assert status == 0, err
    assert tested == [(hand, "student", seed) for seed in (0, 4) for hand in ("shadow", "faive", "allegro")]
    result = read_result(tmp_path / "out" / "hands.json")
    rates = [one["conditions"]["reality"]["success_rate"] for one in result.header["policies"]]
    assert rates == [0.5, 0.75, 0.75] and len(result.rows) == 3 * 2 * len(CONDITIONS) * 2
    assert "Shadow" in out and "75.0%" in out and "as shown" in out and "0.0%" in out
    again = run_benchmark(capsys, *command, "--out", tmp_path / "out")
    assert again[0] == 0 and len(tested) == 6, "nothing is tested twice"
    other = run_benchmark(capsys, *command, "--steps", 1e5, "--out", tmp_path / "out")
    assert other[0] == 0 and len(tested) == 12, "but with other settings"
    one = run_benchmark(capsys, *command, "--only", "faive", "--out", tmp_path / "out")
    assert one[0] == 0 and "Faive" in one[1] and "Shadow" not in one[1] and len(tested) == 12


def test_the_interval_of_a_mean_counts_groups_not_values():
    rng = np.random.default_rng(0)
    of_grasp = rng.random(100) < 0.8
    groups = np.repeat(np.arange(100), 3)
    repeated = np.repeat(of_grasp, 3).astype(float)
    low, high = mean_interval(repeated, groups)
    wilson = wilson_interval(int(of_grasp.sum()), 100)
    np.testing.assert_allclose((low, high), wilson, atol=0.015)
    narrower = wilson_interval(3 * int(of_grasp.sum()), 300)
    assert high - low > 1.4 * (narrower[1] - narrower[0])
    assert mean_interval(np.array([0.0, 1.0]), [4, 4]) == (0.5, 0.5)


def test_rows_are_compared_on_the_same_grasps_and_for_the_number_of_comparisons():
    rng = np.random.default_rng(0)
    easy = rng.random(60) < 0.5

    def results(success):
        trials = [{"index": i, "success": bool(one), "held_as_shown": False} for i, one in enumerate(success)]
        return {name: {"trials": trials} for name in CONDITIONS}

    variants = [v for v in TABLES["privileged"] if v.name in ("without", "student")]
    better = [results(easy | (np.arange(60) < 30)) for _ in range(2)]
    tests = paired_tests(variants, [[results(easy) for _ in range(2)], better])
    assert len(tests) == 4 and {test["than"] for test in tests} == {"w/o Priv. Info."}
    success = tests[0]
    gained = float(((np.arange(60) < 30) & ~easy).mean())
    assert success["difference"] == pytest.approx(gained)
    assert success["interval"][0] < gained < success["interval"][1] and success["p"] < 0.01
    assert tests[1]["difference"] == 0 and tests[1]["p"] == 1.0, "never held as shown"
    # Two seeds that agree tell no more than one.
    assert paired_tests(variants, [[results(easy)], better[:1]]) == tests
    assert paired_tests(variants[:1], [better]) == []


def test_curves_have_a_band_over_the_seeds():
    one = np.array([[1e5, 0.2, 0.0], [2e5, 0.4, 0.1]])
    drawn = curves_svg({"Teacher": [one, one + np.array([0.0, 0.2, 0.1])]})
    assert drawn.count("Teacher (2)") == 1 and "held as shown" in drawn
