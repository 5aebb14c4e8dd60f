"""``fungrasp hands`` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from fungrasp.cli.main import main
from fungrasp.hands import hand_files, load_hand


def test_list_names_every_hand(capsys):
    assert main(["hands", "list"]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split()[:2] == ["name", "fingers"]
    assert [row.split()[0] for row in rows] == list(hand_files())
    allegro = next(row for row in rows if row.startswith("allegro"))
    assert allegro.split()[1:4] == ["4", "16/16", "0.97"]


def test_show(capsys):
    assert main(["hands", "show", "allegro"]) == 0
    out = capsys.readouterr().out
    assert "ff_proximal > ff_medial > ff_distal > ff_tip_centre" in out
    assert "0.263 to 1.396" in out


def test_show_draws_a_picture(tmp_path: Path, capsys):
    assert main(["hands", "show", "allegro", "--json", "--picture", str(tmp_path / "a.png")]) == 0
    json.loads(capsys.readouterr().out)
    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture)
    assert pixels.shape[0] > 300 and pixels.shape[1] > 300
    assert pixels.std() > 5.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("show", "allegro", "--picture", "a.txt"), "a picture is a .png or .jpg or .jpeg file"),
        (("show", "alegro"), "unknown hand 'alegro'. Did you mean 'allegro'?"),
        (("export", "allegro", "--out", "file/H.xml"), "cannot write"),
        (("export", "allegro", "--out", "H.xml", "--arm", "ur5x"), "Did you mean 'ur5"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(tmp_path: Path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert main(["hands", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_add_makes_a_hand_of_an_exported_model(tmp_path: Path, capsys):
    model = tmp_path / "mine.xml"
    assert main(["hands", "export", "allegro", "--out", str(model)]) == 0
    assert main(["hands", "add", str(model), "--out", str(tmp_path / "mine")]) == 0
    assert "a right hand, palm 'palm'" in capsys.readouterr().out
    mine, original = load_hand(tmp_path / "mine"), load_hand("allegro")
    for name in ("index", "middle", "ring"):
        assert mine.fingers[name].links == original.fingers[name].links


@pytest.mark.parametrize(("arm", "actuators"), [([], 16), (["--arm", "ur5e"], 22)])
def test_export(tmp_path: Path, capsys, arm, actuators):
    out = tmp_path / "new" / "H.xml"
    assert main(["hands", "export", "allegro", "--out", str(out), *arm]) == 0
    assert str(out) in capsys.readouterr().out
    assert mujoco.MjModel.from_xml_path(str(out)).nu == actuators
    assert list(out.parent.iterdir()) == [out]
