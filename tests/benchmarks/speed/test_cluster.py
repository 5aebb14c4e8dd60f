"""The cluster benchmark: one process beside a cluster that loses a machine."""

from __future__ import annotations

import numpy as np
import pytest
from benchmark_runs import run_benchmark

from fungrasp.evaluation.result_files import read_result
from fungrasp.grasps import builtin_grasps, load_objects, save_robot_grasps
from fungrasp.retargeting import retarget


@pytest.mark.slow
def test_it_compares_with_one_process_after_a_loss(tmp_path, capsys):
    pytest.importorskip("ray", reason="needs Ray: pip install 'fungrasp[ray]'")
    human = builtin_grasps().select(np.arange(0, 120, 5))
    grasps, path = tmp_path / "robot.npz", tmp_path / "c.json"
    save_robot_grasps(grasps, retarget(human, load_objects(human), "allegro", threads=2))
    arguments = ("--grasps", grasps, "--number", 32, "--json", path, "--lose")
    status, out, _ = run_benchmark(capsys, "speed", "cluster", *arguments)
    assert status == 0
    result = read_result(path)
    numbers, (alone, cluster) = result.header, result.rows
    assert "32 of 32 outcomes are the same" in out and "one machine lost" in out
    assert numbers["equal"] == numbers["grasps"] == 32 and numbers["jobs"] == 4
    assert 1.0 <= cluster["processors"] <= 2.0 and 0 < cluster["at_work"] <= 1.0
    work = alone["processor_seconds"] / cluster["processor_seconds"]
    assert numbers["work_per_processor_second"] == pytest.approx(work)
    assert numbers["share"] == pytest.approx(work * cluster["at_work"])


def test_it_does_not_take_the_last_machine(capsys):
    status, _, err = run_benchmark(capsys, "speed", "cluster", "--machines", 1, "--lose")
    assert status == 2 and "2 with --lose" in err
