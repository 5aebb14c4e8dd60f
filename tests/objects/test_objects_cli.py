"""``fungrasp objects`` as a user calls it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

from fungrasp.cli.main import main
from fungrasp.objects import object_names


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def brick(tmp_path):
    path = tmp_path / "brick.stl"
    trimesh.creation.box((0.2, 0.1, 0.05)).export(path)
    return path


def test_list(capsys):
    assert main(["objects", "list"]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split()[:2] == ["name", "parts"]
    assert [row.split()[0] for row in rows] == list(object_names())
    assert "body, rim, handle" in next(row for row in rows if row.startswith("mug"))


def test_list_as_json_with_a_folder(capsys, brick):
    assert main(["objects", "list", "--json", "--objects", str(brick.parent)]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["brick"]["path"] == str(brick)
    assert rows["scissors"]["parts"] == ["loops", "blades"]


def test_show(capsys):
    assert main(["objects", "show", "mug"]) == 0
    out = capsys.readouterr().out
    assert "watertight" in out
    assert "0.35 kg" in out
    assert "handle, " in out
    assert "18 convex" in out
    assert main(["objects", "show", "box:60x28x30", "--mass", "0.1"]) == 0
    assert "[1.403e-05, 0.000e+00, 0.000e+00]" in capsys.readouterr().out


def test_show_a_file_as_json(capsys, brick):
    assert main(["objects", "show", str(brick), "--mass", "2", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(shown["size"], [0.2, 0.1, 0.05], atol=1e-6)
    assert shown["inertia"][2][2] == pytest.approx(2 / 12 * (0.2**2 + 0.1**2), rel=1e-5)
    assert shown["volume"] == pytest.approx(1e-3, rel=1e-5)
    assert shown["pieces"] == 1
    assert shown["repairs"] == []


@pytest.mark.parametrize("by_path", [True, False])
def test_a_mesh_without_mass_has_no_inertia(capsys, brick, by_path):
    names = [str(brick)] if by_path else ["brick", "--objects", str(brick.parent)]
    assert main(["objects", "show", *names]) == 0
    out = capsys.readouterr().out
    assert "unknown: give --mass" in out
    assert "inertia" not in out


@pytest.mark.parametrize("options", [[], ["--pieces"]])
def test_picture(tmp_path, capsys, options):
    path = tmp_path / "mug.png"
    assert main(["objects", "show", "mug", "--picture", str(path), *options]) == 0
    pixels = np.asarray(Image.open(path)).reshape(-1, 3).astype(int)
    orange = (pixels[:, 0] > 180) & (pixels[:, 2] < 90)
    assert orange.mean() > 0.003
    assert "wrote" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show", "mgu"], "Did you mean 'mug'"),
        (["show", "mug", "--mass", "-1"], "'mug': the mass must be positive"),
        (["show", "mug", "--picture", "mug.gif"], "a picture is a .png or .jpg or .jpeg file, not mug.gif"),
        (["show", "mug", "--objects", "nowhere"], "nowhere does not exist"),
        (["show", "mug", "--objects", __file__], "is a file: give the folder it lies in"),
        (["show", "nothing.obj"], "unknown object 'nothing.obj'"),
    ],
)
def test_mistakes_get_one_line(arguments, message, capsys):
    assert main(["objects", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
