"""Worlds are measured, and what can't be is left out in words."""

from __future__ import annotations

import json

from small_training import hand, library, training_set

from benchmarks.gpu import ManyWorlds, world_speed
from fungrasp.cli.main import run_command


def test_the_shares_of_training_are_all_of_its_time():
    one = training_set()
    speed = world_speed(library(), one.objects, hand(), "cpu", 2, steps=2, threads=1)
    assert speed.physics_share + speed.task_share + speed.learning_share == 1.0
    assert min(speed.physics_share, speed.task_share, speed.learning_share) > 0
    assert speed.training_steps < speed.environment_steps < speed.physics_steps
    assert speed.bytes_per_world is None and speed.problems == ()


def test_a_device_that_is_missing_is_left_out(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fungrasp.simulation.warp_device.find_spec", lambda name: None)
    options = ["--devices", "cuda", "cpu", "--worlds", "1", "--grasps", "1", "--steps", "1", "--threads", "1"]
    files = ["--json", str(tmp_path / "speed.json")]
    assert run_command("gpu", ManyWorlds, options + files) == 0
    shown = capsys.readouterr().out
    assert "cuda with 1 worlds is left out: device cuda needs warp" in shown
    kept = json.loads((tmp_path / "speed.json").read_text())
    assert [one["device"] for one in kept["each"]] == ["cpu"] and "MuJoCo" in kept["machine"]
