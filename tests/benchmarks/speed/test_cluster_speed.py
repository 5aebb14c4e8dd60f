"""The benchmark of a cluster."""

from __future__ import annotations

import pytest
from benchmark_runs import run_benchmark

from fungrasp.evaluation import read_result

pytest.importorskip("ray", reason='needs Ray: pip install "fungrasp[ray]"')


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_benchmark_compares_with_one_process_after_a_loss(tmp_path, capsys):
    path = tmp_path / "c.json"
    status, out, _ = run_benchmark(capsys, "speed", "cluster", "--number", 32, "--json", path, "--lose")
    assert status == 0
    result = read_result(path)
    numbers, (alone, cluster) = result.header, result.rows
    assert "32 of 32 outcomes are the same" in out and "one machine lost" in out
    assert numbers["equal"] == numbers["grasps"] == 32 and numbers["jobs"] == 4
    assert 1.0 <= cluster["processors"] <= 2.0 and 0 < cluster["at_work"] <= 1.0
    work = alone["processor_seconds"] / cluster["processor_seconds"]
    assert numbers["work_per_processor_second"] == pytest.approx(work)
    assert numbers["share"] == pytest.approx(work * cluster["at_work"])


def test_the_benchmark_does_not_take_the_last_machine(capsys):
    status, _, err = run_benchmark(capsys, "speed", "cluster", "--machines", 1, "--lose")
    assert status == 2 and "2 with --lose" in err
