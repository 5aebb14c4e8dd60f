"""Objects by name: lookup, mass properties, signed distance."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.objects import (
    ObjectModel,
    load_object,
    mesh_files,
    object_from_file,
    object_names,
    object_registry,
)


@pytest.fixture
def folder(tmp_path) -> Path:
    for name in ("brick.stl", "brick.ply", "mug.obj"):
        trimesh.creation.box((0.2, 0.1, 0.05)).export(tmp_path / name)
    (tmp_path / "notes.txt").write_text("not a mesh")
    return tmp_path


def test_a_box_has_the_inertia_of_a_box(folder):
    model = load_object("brick", 2.0, folder)
    expected = 2.0 / 12 * np.array([0.1**2 + 0.05**2, 0.2**2 + 0.05**2, 0.2**2 + 0.1**2])
    np.testing.assert_allclose(model.inertia, np.diag(expected), atol=1e-9)
    np.testing.assert_allclose(model.center_of_mass, 0, atol=1e-9)
    np.testing.assert_allclose(model.size, [0.2, 0.1, 0.05], atol=1e-7)
    assert model.parts == {}
    assert len(model.pieces) == 1


def test_inertia_is_about_the_center_of_mass():
    box = trimesh.creation.box((0.2, 0.1, 0.05))
    here = ObjectModel("box", 1.0, box.vertices, box.faces)
    there = ObjectModel("box", 1.0, box.vertices + np.array([0.3, -0.2, 0.1]), box.faces)
    np.testing.assert_allclose(there.inertia, here.inertia, atol=1e-12)
    np.testing.assert_allclose(there.center_of_mass, [0.3, -0.2, 0.1], atol=1e-12)


def test_the_folder_comes_before_the_built_in_objects(folder):
    assert load_object("mug", 1.0, folder).parts == {}
    assert "handle" in load_object("mug", 1.0).parts


def test_obj_comes_before_stl_before_ply(folder):
    assert mesh_files(folder)["brick"].suffix == ".stl"
    trimesh.creation.box((0.1, 0.1, 0.1)).export(folder / "brick.obj")
    assert mesh_files(folder)["brick"].suffix == ".obj"


def test_an_object_is_loaded_once_until_its_file_changes(folder):
    first = load_object("brick", 1.0, folder)
    assert load_object("brick", 1.0, str(folder)) is first
    assert load_object("brick", 2.0, folder).vertices is first.vertices
    trimesh.creation.box((0.1, 0.1, 0.1)).export(folder / "brick.stl")
    os.utime(folder / "brick.stl", ns=(1, 1))
    assert load_object("brick", 1.0, folder).size[0] == pytest.approx(0.1)


def test_unknown_names_list_the_folder_and_the_built_ins(folder):
    with pytest.raises(UnknownNameError, match=r"unknown object 'brik'\. Did you mean 'brick'") as caught:
        load_object("brik", 1.0, folder)
    assert "hammer" in str(caught.value)


@pytest.mark.parametrize("name", ["../brick", "brick.stl", "", "/etc/passwd"])
def test_a_name_is_not_a_path(folder, name):
    with pytest.raises(UnknownNameError):
        load_object(name, 1.0, folder)


def test_a_path_is_loaded(folder):
    brick = load_object(folder / "brick.stl", 1.0)
    assert brick.name == "brick"
    assert np.array_equal(brick.vertices, load_object("brick", 1.0, folder).vertices)
    with pytest.raises(FungraspError, match=r"nothing\.stl"):
        load_object(folder / "nothing.stl", 1.0)


def test_a_mesh_needs_a_mass(folder):
    with pytest.raises(FungraspError, match="'brick': a mesh needs a mass"):
        load_object("brick", None, folder)


@pytest.mark.parametrize("mass", [0.0, -0.1, float("nan"), float("inf")])
def test_bad_mass(folder, mass):
    with pytest.raises(FungraspError, match="'brick': the mass must be positive and finite"):
        load_object("brick", mass, folder)


def test_missing_folder(tmp_path):
    with pytest.raises(FungraspError, match="nowhere does not exist"):
        load_object("mug", 1.0, tmp_path / "nowhere")


def test_a_path_gives_an_object(folder):
    assert object_from_file(folder / "brick.ply", 1.0).name == "brick"


def test_objects_of_another_package(folder, monkeypatch):
    class Entry:
        def load(self):
            return lambda: folder

    monkeypatch.setattr(
        object_registry, "entry_points", lambda group: [Entry()] if group == "fungrasp.objects" else []
    )
    object_registry._packaged_meshes.cache_clear()
    try:
        assert load_object("brick", 1.0).name == "brick"
        assert "handle" in load_object("mug", 1.0).parts
    finally:
        object_registry._packaged_meshes.cache_clear()


def test_signed_distance_is_computed_once_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path))
    box = trimesh.creation.box((0.04, 0.03, 0.02))
    grid = ObjectModel("box", 1.0, box.vertices, box.faces).signed_distance
    center = np.round(-grid.origin / grid.spacing).astype(int)
    assert grid.values[tuple(center)] == pytest.approx(-0.01, abs=0.003)
    assert grid.values[0, 0, 0] > 0.03
    monkeypatch.setattr(
        "fungrasp.objects.object_model.SignedDistanceGrid.from_mesh", lambda *_: pytest.fail("computed again")
    )
    again = ObjectModel("box", 2.0, box.vertices, box.faces).signed_distance
    np.testing.assert_array_equal(again.values, grid.values)


def test_names_are_unique():
    assert len(set(object_names())) == len(object_names()) >= 16
