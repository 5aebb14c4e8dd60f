"""Specifications made for a mesh of which nothing else is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import load_human_grasps
from fungrasp.objects import builtin_object
from fungrasp.synthesis.automatic_specifications import automatic_specifications, parts_from_boxes


def test_a_can_is_held_from_all_sides_and_from_above():
    can = trimesh.creation.cylinder(0.033, 0.12)
    model = replace(builtin_object("can"), vertices=can.vertices, faces=can.faces.astype(np.int32), parts={})
    kinds = {spec.kind for spec in automatic_specifications(model)}
    assert {"wrap", "disk"} <= kinds


def test_a_handle_is_found():
    mug = builtin_object("mug")
    specs = automatic_specifications(replace(mug, parts={}))
    handle = mug.vertices[mug.faces[mug.parts["handle"]]].mean(axis=(0, 1))
    near = [spec for spec in specs if np.linalg.norm(np.array(spec.at) - handle) < 0.02]
    assert any(spec.kind in ("handle", "fist") for spec in near)


def test_parts_given_as_boxes(tmp_path):
    model = replace(builtin_object("mug"), parts={})
    (tmp_path / "parts.json").write_text(json.dumps({"handle": [[0.04, -0.02, -0.05], [0.1, 0.02, 0.05]]}))
    found = parts_from_boxes(model, tmp_path / "parts.json")
    assert 0 < found.parts["handle"].sum() < len(model.faces)
    assert any(spec.part == "handle" for spec in automatic_specifications(found))
    for bad in ({"far": [[1, 1, 1], [2, 2, 2]]}, {"x": [1, 2]}, [], {"x": "y"}):
        (tmp_path / "parts.json").write_text(json.dumps(bad))
        with pytest.raises(FungraspError):
            parts_from_boxes(model, tmp_path / "parts.json")


@pytest.mark.slow
def test_grasps_of_a_mesh(tmp_path, capsys):
    trimesh.creation.cylinder(0.03, 0.12).export(tmp_path / "mine.obj")
    out = tmp_path / "g.npz"
    assert (
        main(["grasps", "make", "--mesh", str(tmp_path / "mine.obj"), "--mass", "0.3", "--out", str(out)])
        == 0
    )
    grasps = load_human_grasps(out)
    assert len(grasps) >= 3 and set(grasps.object_name) == {"mine"} and np.all(grasps.object_mass == 0.3)
