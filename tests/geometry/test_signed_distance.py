"""Signed distances of shapes whose distance is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.signed_distance import (
    SignedDistanceBank,
    SignedDistanceGrid,
    crossing_number,
    mesh_signed_distance,
    nearest_on_mesh,
    winding_number,
)

HALF = np.array([0.03, 0.05, 0.02])
RADIUS = 0.04


def box_distance(points: np.ndarray) -> np.ndarray:
    q = np.abs(points) - HALF
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    return trimesh.creation.box(2 * HALF)


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)


@pytest.fixture(scope="module")
def box_grid(box: trimesh.Trimesh) -> SignedDistanceGrid:
    return SignedDistanceGrid.from_mesh(box.vertices, box.faces, spacing=0.004)


@pytest.fixture(scope="module")
def ball_grid(ball: trimesh.Trimesh) -> SignedDistanceGrid:
    return SignedDistanceGrid.from_mesh(ball.vertices, ball.faces, spacing=0.003)


def cloud(count: int, reach: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-reach, reach, size=(count, 3))


def lookup(grid: SignedDistanceGrid, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    distance, gradient = SignedDistanceBank([grid]).query(np.zeros(1, dtype=int), points[None])
    return distance[0], gradient[0]


def test_mesh_distance_of_a_box_is_exact(box: trimesh.Trimesh):
    points = cloud(500, 0.08)
    np.testing.assert_allclose(mesh_signed_distance(box, points), box_distance(points), atol=1e-9)


def test_nearest_points_on_slivers_are_exact():
    rod = trimesh.creation.cylinder(radius=0.005, height=0.3, sections=24)
    points = cloud(200, 0.02) * [1, 1, 7]
    every = trimesh.triangles.closest_point(
        np.tile(rod.triangles, (len(points), 1, 1)), np.repeat(points, len(rod.faces), axis=0)
    ).reshape(len(points), -1, 3)
    expected = np.linalg.norm(every - points[:, None], axis=-1).min(axis=1)
    nearest, faces = nearest_on_mesh(rod, points)
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), expected, atol=1e-6)
    own = trimesh.triangles.closest_point(rod.triangles[faces], nearest)
    np.testing.assert_allclose(own, nearest, atol=1e-9)


def test_winding_number_counts_shells(box: trimesh.Trimesh):
    twice = trimesh.util.concatenate([box, box])
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    np.testing.assert_allclose(winding_number(twice, points), [2.0, 0.0], atol=1e-5)


def test_grid_of_a_ball(ball_grid: SignedDistanceGrid):
    points = cloud(2000, 0.07)
    points = points[np.linalg.norm(points, axis=1) > 0.01]
    distance, gradient = lookup(ball_grid, points)
    expected = np.linalg.norm(points, axis=1) - RADIUS
    near = np.abs(expected) < 0.004
    assert np.abs(distance - expected)[near].max() < 4e-4
    assert np.abs(distance - expected).max() < 2.5e-3
    normal = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.sum(gradient * normal, axis=1)[near].min() > 0.95
    np.testing.assert_allclose(np.linalg.norm(gradient[near], axis=1), 1.0, atol=0.05)


def test_grid_of_a_box_is_exact_beside_its_faces(box_grid: SignedDistanceGrid):
    beside = cloud(300, 0.01) * [1, 1, 0.5] + [0.0, 0.0, HALF[2]]
    distance, gradient = lookup(box_grid, beside)
    np.testing.assert_allclose(distance, box_distance(beside), atol=1e-6)
    np.testing.assert_allclose(gradient, np.tile([0.0, 0.0, 1.0], (300, 1)), atol=1e-4)


@pytest.mark.parametrize("reach", [0.03, 0.06, 0.3])
def test_gradient_is_the_derivative_inside_and_outside_the_grid(box_grid: SignedDistanceGrid, reach: float):
    points, h = cloud(300, reach, seed=1), 1e-7
    _, gradient = lookup(box_grid, points)
    for axis, shift in enumerate(h * np.eye(3)):
        slope = (lookup(box_grid, points + shift)[0] - lookup(box_grid, points - shift)[0]) / (2 * h)
        assert np.mean(np.abs(slope - gradient[:, axis]) < 1e-4) > 0.99, (
            "only at the edge of a cell may it differ"
        )


def test_outside_the_grid_the_distance_keeps_growing(ball_grid: SignedDistanceGrid):
    way = np.linspace(0.05, 1.0, 50)[:, None] * np.array([0.6, 0.64, 0.48])
    distance, gradient = lookup(ball_grid, way)
    assert np.all(np.diff(distance) > 0)
    true = np.linalg.norm(way, axis=1) - RADIUS
    assert np.all(np.abs(distance - true) < 0.25 * true + 0.002)
    assert np.all(np.sum(gradient * way, axis=1) > 0)


def test_a_thin_shell_has_an_inside():
    """A cup with walls half a cell thick."""
    outer = trimesh.creation.cylinder(radius=0.03, height=0.08, sections=64)
    inner = trimesh.creation.cylinder(radius=0.0285, height=0.08, sections=64)
    inner.apply_translation([0, 0, 0.0015])
    cup = trimesh.boolean.difference([outer, inner], engine="manifold")
    grid = SignedDistanceGrid.from_mesh(cup.vertices, cup.faces, spacing=0.003)
    angles = np.linspace(0, 2 * np.pi, 100)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    in_the_wall, in_the_cup, outside = (lookup(grid, r * ring)[0] for r in (0.02925, 0.015, 0.045))
    assert np.all(in_the_cup > 0.01)
    assert np.all(outside > 0.012)
    assert np.all(np.abs(in_the_wall) < 0.0015)
    assert np.all(lookup(grid, 0.0305 * ring)[0] > -0.0005)


def test_a_small_hole_does_not_turn_the_inside_out(ball: trimesh.Trimesh):
    holed = trimesh.Trimesh(ball.vertices, ball.faces[5:], process=False)
    assert mesh_signed_distance(holed, np.zeros((1, 3)))[0] < -0.03


def test_bank_looks_up_each_grid_by_itself(box_grid: SignedDistanceGrid, ball_grid: SignedDistanceGrid):
    bank = SignedDistanceBank([box_grid, ball_grid])
    points = cloud(200, 0.12).reshape(4, 50, 3)
    which = np.array([1, 0, 0, 1])
    distance, gradient = bank.query(which, points)
    for row, grid in enumerate(which):
        alone = lookup((box_grid, ball_grid)[grid], points[row])
        np.testing.assert_array_equal(distance[row], alone[0])
        np.testing.assert_array_equal(gradient[row], alone[1])


def test_large_things_get_a_coarser_grid(box: trimesh.Trimesh):
    grid = SignedDistanceGrid.from_mesh(5 * box.vertices, box.faces, spacing=0.0025, max_cells=20_000)
    assert grid.values.size < 25_000
    assert grid.spacing > 0.0025


def test_saved_grid_is_the_same(tmp_path: Path, box_grid: SignedDistanceGrid):
    box_grid.save(tmp_path / "box.npz")
    back = SignedDistanceGrid.load(tmp_path / "box.npz")
    assert back.spacing == box_grid.spacing
    np.testing.assert_array_equal(back.origin, box_grid.origin)
    np.testing.assert_array_equal(back.values, box_grid.values)


def test_saving_where_no_folder_can_be_says_so(tmp_path: Path, box_grid: SignedDistanceGrid):
    (tmp_path / "file").write_text("")
    with pytest.raises(FungraspError, match="cannot write"):
        box_grid.save(tmp_path / "file" / "box.npz")


def test_crossings_are_the_winding_number_of_closed_meshes(ball: trimesh.Trimesh, box: trimesh.Trimesh):
    inner = ball.copy()
    inner.apply_scale(0.5)
    inner.invert()
    for mesh in (ball, box, trimesh.util.concatenate([ball, inner])):
        points = np.concatenate([cloud(2000, 0.06), [[0, 0, 0.001], [0, 0, 1.0], [9, 9, 9.0]]])
        wound = np.round(winding_number(mesh, points)).astype(int)
        np.testing.assert_array_equal(crossing_number(mesh, points), wound)
