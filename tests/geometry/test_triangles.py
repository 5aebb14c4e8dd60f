"""Triangle meshes, and rays that meet them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fungrasp.geometry.ray_casting import RayCaster
from fungrasp.geometry.triangle_mesh import (
    hull_triangles,
    normals_and_areas,
    triangle_mesh,
    volume_and_center,
)
from fungrasp.objects import builtin_object


@pytest.mark.parametrize("name", ["mug", "scissors", "spray_bottle", "wine_glass"])
def test_volume_center_and_hull_are_those_of_trimesh(name: str) -> None:
    model = builtin_object(name)
    mesh = triangle_mesh(model.vertices, model.faces)
    volume, center = volume_and_center(model.vertices[model.faces])
    assert volume == pytest.approx(mesh.volume, rel=1e-12)
    np.testing.assert_allclose(center, mesh.center_mass, atol=1e-12)
    normals, areas = normals_and_areas(model.vertices[model.faces])
    np.testing.assert_allclose(areas, mesh.area_faces, rtol=1e-9, atol=1e-18)
    large = areas > 1e-10
    np.testing.assert_allclose(normals[large], mesh.face_normals[large], atol=1e-9)
    hull = hull_triangles(model.vertices)
    assert volume_and_center(hull)[0] == pytest.approx(mesh.convex_hull.volume, rel=1e-12)
    normals, areas = normals_and_areas(hull)
    assert areas.sum() == pytest.approx(mesh.convex_hull.area, rel=1e-9)
    # Nothing of the object is beyond a face of its hull.
    beyond = np.einsum("fi,fi->f", normals, hull[:, 0])
    assert (model.vertices @ normals.T <= beyond + 1e-9).all()


BOX = trimesh.creation.box((0.2, 0.1, 0.06))
BALL = trimesh.creation.icosphere(3, 0.05).apply_translation((0.0, 0.0, 1.0))
CASTER = RayCaster([(BOX.vertices, BOX.faces), (BALL.vertices, BALL.faces)])
UP = np.array([[0.0, 0.0, 1.0]])


def test_the_nearest_mesh_is_hit_from_outside_and_from_inside():
    below, inside, between = (np.array([0.01, 0.02, z]) for z in (-0.5, 0.0, 0.5))
    hits = [CASTER.cast(origin, UP) for origin in (below, inside, between)]
    assert [int(h.mesh[0]) for h in hits] == [0, 0, 1]
    assert [float(h.distance[0]) for h in hits[:2]] == pytest.approx([0.47, 0.03], abs=1e-6)


def test_triangle_and_weights_give_the_point():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = rng.uniform(-0.02, 0.02, (200, 3))
    hits = CASTER.cast(origins, directions)
    assert (hits.mesh == 0).all()
    corners = BOX.vertices[BOX.faces[hits.triangle]]
    points = np.einsum("pc,pci->pi", hits.barycentric, corners)
    np.testing.assert_allclose(points, origins + hits.distance[:, None] * directions, atol=1e-6)
    np.testing.assert_allclose(np.abs(points / [0.1, 0.05, 0.03]).max(1), 1.0, atol=1e-5)


def test_misses_are_infinitely_far():
    hits = CASTER.cast(np.array([0.5, 0.0, 0.0]), UP)
    assert np.isinf(hits.distance[0])
    assert hits.mesh[0] == -1


def test_free_distance_ends_at_the_limit():
    origins = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.8], [0.5, 0.0, 0.0]])
    free = CASTER.free_distance(origins, UP.repeat(3, 0), 0.3)
    np.testing.assert_allclose(free, [0.3, 0.15, 0.3], atol=1e-3)


def test_no_meshes_and_no_rays():
    assert (RayCaster([]).cast(np.zeros(3), UP).mesh == -1).all()
    assert len(CASTER.cast(np.zeros(3), np.empty((0, 3))).distance) == 0
