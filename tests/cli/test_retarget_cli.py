"""The command ``fungrasp retarget``."""

from __future__ import annotations

import json

import numpy as np
import pytest
from grasp_files import check_bad_inputs, run, some_grasps
from PIL import Image

from fungrasp.grasps import load_robot_grasps, save_human_grasps
from fungrasp.hands import load_hand


def test_grasps_quality_and_a_picture(tmp_path, capsys):
    human = some_grasps()
    save_human_grasps(tmp_path / "g.npz", human)
    out, quality, picture = tmp_path / "r.npz", tmp_path / "q.json", tmp_path / "p.png"
    written = ("--out", out, "--quality", quality, "--picture", picture)
    status, words, err = run(capsys, "retarget", "--grasps", tmp_path / "g.npz", *written, "--exact")
    assert status == 0 and err == ""
    robot = load_robot_grasps(out)
    assert robot.hand == "allegro" and robot.joint_names == load_hand("allegro").joint_names
    np.testing.assert_array_equal(robot.object_name, human.object_name)
    np.testing.assert_array_equal(robot.task, human.task)
    numbers = json.loads(quality.read_text())
    for name in (
        "contact_error_mm",
        "contact_gap_mm",
        "link_direction_error_deg",
        "object_penetration_mm",
        "table_penetration_mm",
        "self_penetration_mm",
        "limit_violation_rad",
        "force_closure_residual",
        "force_closure_epsilon",
    ):
        assert set(numbers[name]) == {"mean", "p90", "p95", "max"}
        assert numbers[name]["mean"] == pytest.approx(robot.extra[name].mean())
        assert name.rpartition("_")[0].replace("_", " ") in words
    assert numbers["grasps_per_second"] > 0
    assert numbers["limit_violation_rad"]["max"] == 0
    assert "2 grasps of 2 objects" in words
    with Image.open(picture) as image:
        assert image.width > 1500 and np.asarray(image.convert("RGB")).std() > 10


def test_methods_and_hands(tmp_path, capsys):
    save_human_grasps(tmp_path / "g.npz", some_grasps(("can",)))
    common = ("retarget", "--grasps", tmp_path / "g.npz", "--out", tmp_path / "r.npz")
    assert run(capsys, *common, "--hand", "leap", "--method", "angle-copy")[0] == 0
    assert load_robot_grasps(tmp_path / "r.npz").hand == "leap"


def test_bad_input_is_one_line_and_leaves_no_file(tmp_path, tmp_path_factory, capsys):
    written = ("--out", tmp_path / "r.npz", "--quality", tmp_path / "q.json")
    check_bad_inputs(tmp_path_factory.mktemp("bad"), capsys, "retarget", *written)
    assert list(tmp_path.iterdir()) == []


def test_robot_grasps_are_no_human_grasps(tmp_path, capsys):
    save_human_grasps(tmp_path / "g.npz", some_grasps(("can",)))
    run(capsys, "retarget", "--grasps", tmp_path / "g.npz", "--out", tmp_path / "r.npz")
    status, _, err = run(capsys, "retarget", "--grasps", tmp_path / "r.npz", "--out", tmp_path / "s.npz")
    assert status == 2 and "human grasps are needed here" in err
    assert not (tmp_path / "s.npz").exists()


def test_a_full_disk(tmp_path, capsys, monkeypatch):
    """Nothing is left of the file that did not fit, and an older one stays; what was solved is kept."""
    save_human_grasps(tmp_path / "g.npz", some_grasps(("can",)))
    out = tmp_path / "r.npz"
    out.write_text("older")

    def full(*arguments: object, **named: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    status, _, err = run(capsys, "retarget", "--grasps", tmp_path / "g.npz", "--out", out)
    assert status == 2 and "No space left on device" in err and err.count("\n") == 1
    assert out.read_text() == "older" and {path.name for path in tmp_path.iterdir()} == {
        "g.npz",
        "r.npz",
        "r.npz.partial",
    }
    monkeypatch.undo()
    assert run(capsys, "retarget", "--grasps", tmp_path / "g.npz", "--out", out)[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == {"g.npz", "r.npz"}


def test_a_folder_that_cannot_be_written_to(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    status, _, err = run(capsys, "retarget", "--out", tmp_path / "file" / "r.npz")
    assert status == 2 and "cannot write" in err and err.count("\n") == 1
