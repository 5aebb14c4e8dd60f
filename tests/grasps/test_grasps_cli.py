"""The command ``fungrasp grasps``."""

from __future__ import annotations

import pickle
import types

import numpy as np
import pytest
import trimesh
from bent_hand import bent_hand
from PIL import Image
from test_pickles import labels

from fungrasp.cli.main import main
from fungrasp.grasps import load_human_grasps, save_human_grasps, save_robot_grasps


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    status = main(["grasps", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_list_counts_by_object_and_task(tmp_path, capsys, human_grasps, robot_grasps):
    task = np.array(["drink", "pour", "drink", ""])
    save_human_grasps(tmp_path / "h.npz", human_grasps(4, task=task))
    status, out, _ = run(capsys, "list", "--grasps", tmp_path / "h.npz")
    lines = [line.split() for line in out.splitlines()]
    assert status == 0 and lines[0][:2] == ["object", "task"]
    assert [line[:4] for line in lines[1:4]] == [
        ["object", "0", "drink", "2"],
        ["object", "1", "-", "1"],
        ["object", "1", "pour", "1"],
    ]
    assert out.splitlines()[-1] == "4 grasps of people, 2 objects"
    save_robot_grasps(tmp_path / "r.npz", robot_grasps(3))
    assert "3 grasps of the hand 'claw'" in run(capsys, "list", "--grasps", tmp_path / "r.npz")[1]


def test_show_tells_the_numbers(tmp_path, capsys, human_grasps, robot_grasps):
    contacts = np.zeros((2, 16), dtype=bool)
    contacts[1, [3, 15]] = True
    save_human_grasps(tmp_path / "h.npz", human_grasps(2, link_contacts=contacts))
    status, out, _ = run(capsys, "show", tmp_path / "h.npz", "--grasp", 1)
    assert status == 0 and "task 1" in out and "index_distal, thumb_distal" in out and "179 mm" in out
    save_robot_grasps(tmp_path / "r.npz", robot_grasps(2, joint_positions=np.array([[0.0, 0], [0.25, -1]])))
    status, out, _ = run(capsys, "show", tmp_path / "r.npz", "--grasp", 1)
    assert status == 0 and "claw" in out and "+0.2500 rad" in out and "quality" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("show", "h.npz", "--grasp", 9), "--grasp 9: the grasps are numbered 0 to 1"),
        (("show", "h.npz", "--grasp", -1), "unknown grasp '-1'"),
        (("show", "none.npz"), "none.npz does not exist"),
        (("show", "h.npz", "--picture", "p.png"), "unknown object 'object 0'"),
        (("list", "--grasps", "text"), "not an .npz file"),
        (("import", "dgrasp", "text", "--out", "o.npz"), "cannot read the pickle"),
        (("import", "dexycb", ".", "--out", "o.npz"), "holds no DexYCB sequence"),
        (("import", "other", "nobody", ".", "--out", "o.npz"), "no importer 'nobody'"),
    ],
)
def test_mistakes_are_one_line(tmp_path, monkeypatch, capsys, human_grasps, arguments, words):
    monkeypatch.chdir(tmp_path)
    save_human_grasps("h.npz", human_grasps(2))
    (tmp_path / "text").write_text("text")
    status, _, err = run(capsys, *arguments)
    (error,) = (line for line in err.splitlines() if "warning" not in line)
    assert status == 2 and words in error
    assert {path.name for path in tmp_path.iterdir()} == {"h.npz", "text"}


def test_a_picture_shows_hand_and_object(tmp_path, capsys, human_grasps):
    trimesh.creation.box((0.06, 0.04, 0.1)).export(tmp_path / "block.obj")
    pose = np.array([[0.1, 0, 0.1, 1, 0, 0, 0]])
    grasps = human_grasps(
        1, object_name=["block"], object_pose=pose, hand_joints=bent_hand()[None] + np.array([0, 0, 0.16])
    )
    save_human_grasps(tmp_path / "h.npz", grasps)
    picture = tmp_path / "p.png"
    status, out, _ = run(capsys, "show", tmp_path / "h.npz", "--picture", picture, "--objects", tmp_path)
    assert status == 0 and f"picture: {picture}" in out
    with Image.open(picture) as image:
        assert image.size == (960, 720)
        colors = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    blue, skin = colors[:, 2] - colors[:, 0] > 30, colors[:, 0] - colors[:, 2] > 30
    assert blue.mean() > 0.02 and skin.mean() > 0.02


def test_import_dgrasp(tmp_path, capsys, human_grasps):
    (tmp_path / "labels.pkl").write_bytes(pickle.dumps({14: labels(human_grasps(2))}))
    status, out, _ = run(capsys, "import", "dgrasp", tmp_path / "labels.pkl", "--out", tmp_path / "g.npz")
    assert status == 0 and "2 grasps of 1 objects" in out
    assert load_human_grasps(tmp_path / "g.npz").object_name.tolist() == ["025_mug"] * 2


def test_importers_of_other_packages(tmp_path, capsys, monkeypatch, human_grasps):
    seen = []

    def importer(path):
        seen.append(path)
        return human_grasps(2)

    entry = types.SimpleNamespace(name="theirs", load=lambda: importer)
    monkeypatch.setattr("fungrasp.core.plugins.entry_points", lambda group: [entry])
    status, out, _ = run(capsys, "import", "other", "theirs", tmp_path, "--out", tmp_path / "g.npz")
    assert status == 0 and seen == [tmp_path] and "2 grasps" in out
    status, _, err = run(capsys, "import", "other", "their", tmp_path, "--out", tmp_path / "g.npz")
    assert status == 2 and "Did you mean 'theirs'?" in err
