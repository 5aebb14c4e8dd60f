"""What is asked about meshes without trimesh is what trimesh says."""

from __future__ import annotations

import numpy as np
import pytest

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
