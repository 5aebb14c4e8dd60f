"""Objects by name, plain shapes, other sizes and masses, and the face on which they rest."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from task_scenes import plain

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.objects import (
    ObjectModel,
    builtin_object,
    load_object,
    mesh_files,
    object_registry,
    resolve_object,
    scaled_name,
    scaled_object,
    shifted_mass,
    with_sizes,
)
from fungrasp.objects.builtin_objects import plain_shape
from fungrasp.objects.object_model import broad_settled_up, settled_up


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
    with pytest.raises(UnknownNameError) as caught:
        load_object(name, 1.0, folder)
    assert ("object_from_mesh(path, mass) reads" in str(caught.value)) == name.endswith(".stl")
    if name != "brick.stl":
        with pytest.raises(FungraspError, match="must be a plain name"):
            ObjectModel(name, 1.0, np.eye(3), np.arange(3)[None])


def test_a_path_is_loaded(folder):
    brick = load_object(folder / "brick.stl", 1.0)
    assert brick.name == "brick"
    assert np.array_equal(brick.vertices, load_object("brick", 1.0, folder).vertices)
    with pytest.raises(FungraspError, match=r"nothing\.stl"):
        load_object(folder / "nothing.stl", 1.0)


def test_a_mesh_needs_a_mass(folder):
    for name, words in (("brick", "'brick': a mesh needs a mass"), ("box:60x28x30", "needs a mass")):
        with pytest.raises(FungraspError, match=words):
            load_object(name, None, folder)
    with pytest.raises(FungraspError, match=r"second argument is the mass .* give the folder as folder="):
        load_object("brick", folder)


@pytest.mark.parametrize("mass", [0.0, -0.1, float("nan"), float("inf")])
def test_bad_mass(folder, mass):
    with pytest.raises(FungraspError, match="'brick': the mass must be positive and finite"):
        load_object("brick", mass, folder)


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


@pytest.mark.parametrize(
    ("name", "size", "volume"),
    [
        ("box:60x28x30", (0.060, 0.028, 0.030), 0.060 * 0.028 * 0.030),
        ("cylinder:66x115", (0.066, 0.066, 0.115), np.pi * 0.033**2 * 0.115),
        ("sphere:67.5", (0.0675,) * 3, 4 / 3 * np.pi * 0.03375**3),
    ],
)
def test_a_name_says_the_shape(name, size, volume):
    model = load_object(name, 0.2)
    np.testing.assert_allclose(model.size, size, rtol=3e-3)
    assert model.mesh.volume == pytest.approx(volume, rel=0.012)
    assert model.mesh.is_watertight and len(model.pieces) == 1
    np.testing.assert_allclose(model.center_of_mass, 0.0, atol=1e-9)
    assert (model.name, model.mass) == (name, 0.2)


def test_shapes_are_mirrored_like_other_objects():
    assert load_object("box:60x28x30_mirrored", 0.2).mesh.volume > 0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("box:60x28", "write box:LENGTHxWIDTHxHEIGHT"),
        ("box:60x28x-3", "not a shape"),
        ("sphere:nan", "not a shape"),
        ("cylinder:0.01x100", "1 to 1500 mm"),
        ("box:" + "9" * 5000, "not a shape"),
        ("cone:3x4", "unknown object"),
        ("box:60x28x30" + "x1" * 100, "not a shape"),
    ],
)
def test_other_names_are_refused_in_words(name, words):
    with pytest.raises(FungraspError, match=words):
        load_object(name, 0.2)


@pytest.mark.parametrize(
    ("name", "words"), [("9" * 300, "unknown object"), ("a/" * 3000 + "b.obj", "too long")]
)
def test_names_too_long_for_a_file_are_refused_in_words(name, words):
    with pytest.raises(FungraspError, match=words):
        resolve_object(name)


def test_another_size_has_all_lengths_larger_and_the_same_mass():
    mug = builtin_object("mug")
    large = scaled_object(mug, 1.01)
    assert large.name == "mug x1.01" and large.mass == mug.mass
    np.testing.assert_allclose(large.size, 1.01 * mug.size)
    np.testing.assert_allclose(large.center_of_mass, 1.01 * mug.center_of_mass, atol=1e-9)
    np.testing.assert_allclose(large.inertia, 1.01**2 * mug.inertia, rtol=1e-6, atol=1e-12)
    assert len(large.pieces) == len(mug.pieces)
    np.testing.assert_allclose(large.pieces[0].vertices, 1.01 * mug.pieces[0].vertices)


def test_distances_of_another_size_are_scaled_along():
    mug = builtin_object("mug")
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (1, 20, 3))
    bank = SignedDistanceBank([mug.signed_distance, scaled_object(mug, 1.2).signed_distance])
    own, _ = bank.query(np.array([0]), points)
    other, _ = bank.query(np.array([1]), 1.2 * points)
    np.testing.assert_allclose(other, 1.2 * own, atol=1e-6)


def test_sizes_have_names_of_their_own_and_the_objects_keep_theirs():
    objects = {name: builtin_object(name) for name in ("mug", "can")}
    sizes = with_sizes(objects, (0.99, 1.0, 1.01))
    assert list(sizes) == ["mug", "can", "mug x0.99", "can x0.99", "mug x1.01", "can x1.01"]
    assert sizes["can"] is objects["can"] and scaled_name("can", 1.0) == "can"
    assert list(with_sizes(objects, (1.0,))) == ["mug", "can"]


def test_without_a_shift_the_mass_is_where_it_was():
    box = plain("box", (0.1, 0.2, 0.3))
    center, inertia = shifted_mass(
        box.center_of_mass[None], box.inertia[None], np.array([box.mass]), box.size[None], np.zeros((1, 3))
    )
    np.testing.assert_array_equal(center[0], box.center_of_mass)
    np.testing.assert_array_equal(inertia[0], box.inertia)


def test_a_shifted_mass_is_that_of_a_box_with_a_weight_at_its_wall():
    """15 % along one axis: 30 % of the mass sits in the middle of the wall there."""
    box, mass = plain("box", (0.1, 0.2, 0.3), 1.0), 1.0
    shift = np.array([[0.0, 0.15, 0.0]])
    center, inertia = shifted_mass(
        box.center_of_mass[None], box.inertia[None], np.array([mass]), box.size[None], shift
    )
    np.testing.assert_allclose(center[0], [0.0, 0.03, 0.0], atol=1e-12)
    # 0.7 kg of box 3 cm from the new center, 0.3 kg 7 cm from it on the other side.
    beside = 0.7 * 0.03**2 + 0.3 * 0.07**2
    np.testing.assert_allclose(inertia[0], 0.7 * box.inertia + beside * np.diag([1.0, 0.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize("name", ["tennis_ball", "mug", "drill", "scissors"])
def test_a_shifted_mass_is_always_possible(name):
    """Principal moments obey the triangle inequality: no part of the mass is negative."""
    obj, count = builtin_object(name), 200
    shift = np.random.default_rng(0).uniform(-0.15, 0.15, (count, 3))
    _, inertia = shifted_mass(
        np.tile(obj.center_of_mass, (count, 1)),
        np.tile(obj.inertia, (count, 1, 1)),
        np.full(count, obj.mass),
        np.tile(obj.size, (count, 1)),
        shift,
    )
    moments = np.linalg.eigvalsh(inertia)
    assert (moments[:, 0] > 0).all() and (moments[:, 0] + moments[:, 1] >= moments[:, 2] * (1 - 1e-9)).all()


def leaning(axis: np.ndarray) -> np.ndarray:
    direction = axis + np.array([0.12, -0.1, 0.08])
    return direction / np.linalg.norm(direction)


def test_a_box_is_put_down_on_the_face_that_is_nearest() -> None:
    box = plain_shape("box:60x110x170", 0.5)
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        np.testing.assert_allclose(broad_settled_up(box, leaning(axis)), axis, atol=1e-6)


def test_nothing_is_put_down_on_a_narrow_face(tmp_path) -> None:
    """A slab with a narrow foot: it could stand on it, and the least tilt would tip it."""
    slab = trimesh.creation.box([0.10, 0.10, 0.03])
    foot = trimesh.creation.box([0.006, 0.10, 0.002])
    foot.apply_translation([0.0, 0.0, -0.05])
    corners = np.concatenate([slab.vertices, foot.vertices])
    trimesh.convex.convex_hull(corners).export(tmp_path / "keel.obj")
    keel = load_object(tmp_path / "keel.obj", mass=0.2)
    up = leaning(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(settled_up(keel, up), [0, 0, 1], atol=1e-6)
    assert broad_settled_up(keel, up)[2] < 0.99
