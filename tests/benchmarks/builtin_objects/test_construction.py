"""The meshes that come with the package are what the construction makes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.builtin_objects.__main__ import CONSTRUCTIONS, write_builtin_objects
from benchmarks.builtin_objects.assembly import assemble
from fungrasp.geometry.triangle_mesh import volume_and_center
from fungrasp.objects import builtin_object, object_names
from fungrasp.objects.builtin_objects import MESHES


def areas(triangles: np.ndarray) -> float:
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(sides, axis=1).sum() / 2)


def test_every_built_in_object_has_a_construction() -> None:
    assert tuple(CONSTRUCTIONS) == object_names()


@pytest.mark.parametrize("name", CONSTRUCTIONS)
def test_the_file_holds_what_the_construction_makes(name: str) -> None:
    """The surface and its parts; where triangles lie in it is up to the version of manifold3d."""
    vertices, faces, masks, pieces = assemble(CONSTRUCTIONS[name]())
    model = builtin_object(name)
    made, kept = vertices[faces], model.vertices[model.faces]
    for one, other in zip(volume_and_center(made), volume_and_center(kept), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8)
    # A ball's outermost vertices are up to its triangles, by 0.1 mm.
    within = 2e-4 if name == "tennis_ball" else 1e-9
    np.testing.assert_allclose(vertices.min(axis=0), model.vertices.min(axis=0), atol=within)
    np.testing.assert_allclose(vertices.max(axis=0), model.vertices.max(axis=0), atol=within)
    assert list(masks) == list(model.parts) and len(pieces) == len(model.pieces)
    for part, mask in masks.items():
        assert areas(made[mask]) == pytest.approx(areas(kept[model.parts[part]]), rel=1e-6)


def test_the_file_is_read_as_it_is_written(tmp_path: Path) -> None:
    write_builtin_objects(tmp_path / "again.npz")
    made, kept = np.load(tmp_path / "again.npz"), np.load(MESHES)
    assert list(made) == list(kept)
    np.testing.assert_array_equal(made["part_names"], kept["part_names"])
    np.testing.assert_allclose(made["points"].mean(axis=0), kept["points"].mean(axis=0), atol=1e-4)
