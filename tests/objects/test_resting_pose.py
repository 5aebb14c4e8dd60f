"""On which face an object rests."""

import numpy as np
import trimesh

from fungrasp.objects import load_object
from fungrasp.objects.builtin_objects import plain_shape
from fungrasp.objects.object_model import broad_settled_up, settled_up


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
