"""The benchmark of hands that were added."""

from __future__ import annotations

from benchmark_runs import run_benchmark
from odd_hands import odd_hand

from fungrasp.evaluation.result_files import read_result


def test_hands_are_added_and_tried_or_refused_with_a_reason(tmp_path, capsys):
    (tmp_path / "odd.xml").write_text(odd_hand(left=True))
    (tmp_path / "none.xml").write_text("<mujoco/>")
    path = tmp_path / "hands.json"
    status, out, _ = run_benchmark(
        capsys,
        "hands",
        f"Odd, left={tmp_path}/odd.xml",
        f"None={tmp_path}/none.xml",
        "--every",
        60,
        "--json",
        path,
    )
    assert status == 0 and "Odd, left: " in out
    odd, none = read_result(path).rows
    assert (odd["side"], odd["fingers"], odd["driven"], odd["grasps"]) == ("left", 5, 20, 2)
    assert 0 <= odd["lifted"] <= 2 and odd["contact_error_mm"] > 0 and not odd["refused"]
    assert "joints" in none["refused"] and none["lifted"] is None
    assert run_benchmark(capsys, "hands", tmp_path / "odd.xml")[0] == 2
