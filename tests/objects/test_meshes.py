"""Reading, checking and mending mesh files."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import CannotWriteError
from fungrasp.geometry.shell_from_triangles import zero_surface
from fungrasp.objects import builtin_object, disk_cache, load_mesh, mesh_file
from fungrasp.objects.disk_cache import cached_on_disk
from fungrasp.objects.mesh_repair import consistent_winding, fill_holes

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared"


def saved(mesh: trimesh.Trimesh | trimesh.Scene, path: Path) -> Path:
    mesh.export(path)
    return path


def loaded(path: Path) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    vertices, faces, repairs = load_mesh(path)
    assert vertices.dtype == np.float64
    assert faces.dtype == np.int32
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    return mesh, repairs


def ball(subdivisions: int = 3) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions, 0.05)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb"])
def test_a_good_mesh_needs_no_repair(tmp_path, suffix):
    mesh, repairs = loaded(saved(ball(), tmp_path / f"ball.{suffix}"))
    assert repairs == ()
    assert mesh.volume == pytest.approx(ball().volume, rel=1e-4)


def test_a_file_is_read_once_until_it_changes(tmp_path, monkeypatch, caplog):
    """To read one takes another process and trimesh: what was made of it is kept."""
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "cache"))
    inside_out = ball()
    inside_out.invert()
    path = saved(inside_out, tmp_path / "ball.ply")
    first = load_mesh(path)
    reader = mesh_file.read_mesh
    monkeypatch.setattr(mesh_file, "read_mesh", None)
    caplog.clear()
    for before, again in zip(first[:2], load_mesh(path)[:2], strict=True):
        assert before.dtype == again.dtype
        np.testing.assert_array_equal(before, again)
    assert first[2] == load_mesh(path)[2] == ("turned the faces outwards",)
    assert "turned the faces outwards" in caplog.text
    monkeypatch.setattr(mesh_file, "read_mesh", reader)
    assert len(load_mesh(saved(ball(2), path))[1]) < len(first[1])


def test_a_scene_keeps_its_transforms_and_overlapping_bodies_become_one(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((0.04, 0.04, 0.04)))
    aside = trimesh.transformations.translation_matrix([0.03, 0, 0])
    scene.add_geometry(trimesh.creation.box((0.04, 0.04, 0.04)), transform=aside)
    mesh, repairs = loaded(saved(scene, tmp_path / "two.glb"))
    assert repairs == ("united bodies that overlap",)
    assert mesh.volume == pytest.approx(0.07 * 0.04 * 0.04, rel=1e-4)


def test_bodies_apart_stay_apart(tmp_path):
    other = ball()
    other.apply_translation([0.2, 0, 0])
    mesh, repairs = loaded(saved(trimesh.util.concatenate([ball(), other]), tmp_path / "two.obj"))
    assert repairs == ("separate bodies with 100 mm between them were taken as one object",)
    assert mesh.volume == pytest.approx(2 * ball().volume, rel=1e-4)


def test_small_holes_are_filled_and_said(tmp_path, caplog):
    mesh = ball()
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.047)
    mended, repairs = loaded(saved(mesh, tmp_path / "ball.ply"))
    assert repairs == ("filled 1 hole",)
    assert "ball.ply: filled 1 hole" in caplog.text
    assert mended.volume == pytest.approx(ball().volume, rel=0.02)


def test_an_open_surface_becomes_a_shell(tmp_path):
    mesh = ball()
    mesh.update_faces(mesh.triangles_center[:, 2] < 0)
    sheet = mesh.area
    mended, repairs = loaded(saved(mesh, tmp_path / "bowl.obj"))
    assert len(repairs) == 1
    assert "shell 2 mm thick" in repairs[0]
    assert mended.volume == pytest.approx(sheet * 0.002, rel=0.05)


def test_without_repair_an_open_surface_is_an_error(tmp_path):
    mesh = ball()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    with pytest.raises(FungraspError, match=r"ball\.obj: the surface is not closed"):
        load_mesh(saved(mesh, tmp_path / "ball.obj"), repair=False)


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (
            1000.0,
            r"100 m long, larger than the table \(1.5 m\); it would be 100 mm if it is in mm .*by 0.001",
        ),
        (100.0, r"10 m long, .* or 100 mm if it is in cm \(scale the mesh by 0.01\)"),
        (4 / 0.0254 / 4, r"3.937 m long, .* 100 mm if it is in inches \(scale the mesh by 0.0254\)"),
        (20.0, r"2 m long, larger than the table \(1.5 m\)"),
        (0.001, "only 0.0001 m long"),
    ],
)
def test_wrong_units(tmp_path, scale, message):
    mesh = ball()
    mesh.apply_scale(scale)
    with pytest.raises(FungraspError, match=rf"ball\.ply: {message}"):
        load_mesh(saved(mesh, tmp_path / "ball.ply"))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("empty.obj", "", "no faces"),
        ("points.obj", "v 0 0 0\nv .1 0 0\nv 0 .1 0\n", "no faces"),
        ("nan.obj", "v 0 0 0\nv nan 0 0\nv 0 .1 0\nf 1 2 3\n", "vertex 1 is not finite"),
        ("line.obj", "v 0 0 0\nv .1 0 0\nv .2 0 0\nf 1 2 3\n", "no face with an area"),
        ("junk.ply", "hello", "cannot read the mesh"),
        ("junk.xyzzy", "hello", "cannot read the mesh"),
        ("none.obj", None, r"none\.obj does not exist"),
    ],
)
def test_useless_files(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(FungraspError, match=message) as caught:
        load_mesh(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_flipped_faces_are_flipped_back(seed):
    mesh = ball(2)
    flip = np.random.default_rng(seed).random(len(mesh.faces)) < 0.4
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    mended = consistent_winding(trimesh.Trimesh(mesh.vertices, faces, process=False))
    assert mended.is_winding_consistent
    assert abs(mended.volume) == pytest.approx(mesh.volume)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 319))
def test_a_missing_face_is_filled(face):
    mesh = ball(2)
    mesh.update_faces(np.arange(len(mesh.faces)) != face)
    mended, count = fill_holes(mesh, widest=0.05)
    assert count == 1
    assert mended.is_watertight
    assert mended.is_winding_consistent


@pytest.mark.skipif(not (SHARED / "data/ycb").is_dir(), reason="needs the YCB meshes beside the repository")
def test_ycb_meshes_need_no_repair():
    for path in sorted((SHARED / "data/ycb").glob("*.obj")):
        assert loaded(path)[1] == (), path.name


def test_a_large_mesh_is_simplified_and_the_error_said(tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_file, "MOST_FACES", 2000)
    mesh, repairs = loaded(saved(ball(5), tmp_path / "ball.ply"))
    (phrase,) = repairs
    assert re.fullmatch(r"simplified; the surface moved by at most [\d.]+ mm", phrase)
    assert len(mesh.faces) <= 2000
    off = float(phrase.split()[-2]) / 1000
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.05).max() <= off
    assert mesh.volume == pytest.approx(ball(5).volume, rel=0.02)


def test_loose_triangles_are_made_a_shell_or_refused_in_words(tmp_path):
    random = np.random.default_rng(0)
    corners = random.uniform(0, 0.2, (60, 1, 3)) + random.normal(size=(60, 3, 3)) * 0.02
    loose = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3), process=False)
    _, repairs = loaded(saved(loose, tmp_path / "loose.stl"))
    assert "shell" in repairs[0]
    corners = random.uniform(0, 0.2, (900, 3, 3))
    soup = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(2700).reshape(-1, 3), process=False)
    with pytest.raises(FungraspError, match="are not a surface"):
        load_mesh(saved(soup, tmp_path / "soup.stl"))


def test_the_zero_surface_of_a_ball_on_a_grid_is_closed():
    axes = np.arange(30) - 14.3
    values = np.linalg.norm(np.stack(np.meshgrid(axes, axes, axes, indexing="ij")), axis=0) - 10.0
    vertices, faces = zero_surface(values)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 10**3, rel=0.01)


@pytest.mark.slow
def test_a_scan_of_over_a_million_faces(tmp_path):
    start = time.process_time()
    mesh, _ = loaded(saved(ball(8), tmp_path / "scan.ply"))
    assert len(mesh.faces) <= 100_000 and time.process_time() - start < 60


def test_results_are_kept_for_the_process_where_the_cache_can_not_be_written(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "file" / "cache"))
    disk_cache._temporary_folder.cache_clear()
    found = cached_on_disk("x", "key", Path.read_text, lambda path: Path(path).write_text("value") and None)
    assert found == "value"
    assert "set FUNGRASP_CACHE to a folder that can be written to" in caplog.text

    def write(path):
        if path.is_relative_to(tmp_path):
            raise CannotWriteError("no room")
        path.write_text("value")

    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "full"))
    assert cached_on_disk("x", "another", Path.read_text, write) == "value"


@pytest.mark.parametrize("name", ["wine_glass", "scissors"])
def test_a_closed_surface_whose_parts_touch_is_read_as_it_is(name, tmp_path):
    model = builtin_object(name)
    trimesh.Trimesh(model.vertices, model.faces, process=False).export(tmp_path / "object.stl")
    vertices, faces, repairs = load_mesh(tmp_path / "object.stl")
    read = trimesh.Trimesh(vertices, faces, process=False)
    assert not repairs and read.is_watertight
    assert read.volume == pytest.approx(model.mesh.volume, rel=1e-6)
