"""Convex pieces: faithful, computed once, the same for everybody."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from fungrasp.objects import ConvexPiece, convex_pieces, load_object
from fungrasp.objects.convex_decomposition import DecompositionSettings, fewer_points, mesh_digest
from fungrasp.objects.object_description import piece_fidelity

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def bracket() -> trimesh.Trimesh:
    """An L of 10 cm, which is two boxes."""
    legs = [
        trimesh.creation.box(bounds=b)
        for b in ([(0, 0, 0), (0.1, 0.03, 0.03)], [(0, 0, 0), (0.03, 0.03, 0.1)])
    ]
    return trimesh.boolean.union(legs, engine="manifold")


def kept_files(cache: Path) -> list[Path]:
    return sorted(cache.rglob("*.npz"))


def test_a_bracket_is_two_boxes():
    mesh = bracket()
    pieces = convex_pieces(mesh.vertices, mesh.faces)
    assert len(pieces) == 2
    volume = sum(trimesh.Trimesh(p.vertices, p.faces).volume for p in pieces)
    assert volume == pytest.approx(mesh.volume, rel=0.02)


def test_kept_pieces_are_read_back(cache, monkeypatch):
    mesh = bracket()
    first = convex_pieces(mesh.vertices, mesh.faces)
    assert len(kept_files(cache)) == 1
    monkeypatch.setattr(
        "fungrasp.objects.convex_decomposition._decompose", lambda *_: pytest.fail("computed again")
    )
    assert_same(first, convex_pieces(mesh.vertices, mesh.faces))


def test_other_meshes_and_settings_are_kept_apart(cache):
    mesh = bracket()
    convex_pieces(mesh.vertices, mesh.faces)
    convex_pieces(mesh.vertices * 1.01, mesh.faces)
    convex_pieces(mesh.vertices, mesh.faces, DecompositionSettings(max_pieces=1))
    assert len(kept_files(cache)) == 3


def test_a_broken_file_is_computed_again(cache, caplog):
    mesh = bracket()
    first = convex_pieces(mesh.vertices, mesh.faces)
    (path,) = kept_files(cache)
    path.write_bytes(path.read_bytes()[:100])
    again = convex_pieces(mesh.vertices, mesh.faces)
    assert "computing it again" in caplog.text
    assert len(again) == len(first)


def test_processes_at_once_get_the_same_pieces(cache):
    mesh = bracket()
    context = multiprocessing.get_context("spawn")
    with context.Pool(2) as pool:
        one, two = pool.starmap(convex_pieces, [(mesh.vertices, mesh.faces)] * 2)
    assert_same(one, two)
    assert len(kept_files(cache)) == 1


def test_digest_tells_meshes_apart():
    mesh = bracket()
    digest = mesh_digest(mesh.vertices, mesh.faces)
    assert digest == mesh_digest(mesh.vertices.copy(), mesh.faces.astype(np.int64))
    assert digest != mesh_digest(mesh.vertices + 1e-9, mesh.faces)
    assert digest != mesh_digest(mesh.vertices, mesh.faces[::-1])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(5, 60))
def test_fewer_points_shrink_by_less_than_the_tolerance(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * [0.05, 0.03, 0.01]
    few = fewer_points(points, limit=count, tolerance=0.002)
    planes = ConvexHull(few).equations
    assert (points @ planes[:, :3].T + planes[:, 3]).max(axis=1).max() <= 0.002 + 1e-9


def test_fewer_points_of_a_box_are_its_corners():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    inside = np.random.default_rng(0).uniform(0.1, 0.9, size=(50, 3))
    few = fewer_points(np.concatenate([corners, inside]), limit=64, tolerance=1e-4)
    assert sorted(map(tuple, few)) == sorted(map(tuple, corners))


def test_fewer_points_keeps_to_the_limit():
    points = np.random.default_rng(0).normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    few = fewer_points(points, limit=64, tolerance=0.0)
    assert len(few) == 64
    assert ConvexHull(few).volume > 0.85 * ConvexHull(points).volume


def test_a_fine_mesh_is_simplified_first():
    mesh = trimesh.creation.icosphere(5, 0.05)
    (piece,) = convex_pieces(mesh.vertices, mesh.faces)
    assert len(piece.vertices) <= DecompositionSettings().max_vertices
    assert trimesh.Trimesh(piece.vertices, piece.faces).volume > 0.93 * mesh.volume
    assert np.linalg.norm(piece.vertices, axis=1).min() > 0.0495


@pytest.mark.skipif(not (SHARED / "data/ycb").is_dir(), reason="needs the YCB meshes beside the repository")
@pytest.mark.parametrize(
    "name",
    ["011_banana", *(pytest.param(n, marks=pytest.mark.slow) for n in ("006_mustard_bottle", "024_bowl"))],
)
def test_pieces_of_scanned_objects_are_faithful(name):
    model = load_object(name, 0.1, SHARED / "data/ycb")
    assert len(model.pieces) <= DecompositionSettings().max_pieces
    assert max(len(piece.vertices) for piece in model.pieces) <= DecompositionSettings().max_vertices
    fidelity = piece_fidelity(model)
    assert fidelity.shrink_max < 0.001
    assert fidelity.shrink_mean < 0.0002
    assert fidelity.bulge_mean < 0.002


def assert_same(one: tuple[ConvexPiece, ...], two: tuple[ConvexPiece, ...]) -> None:
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)
