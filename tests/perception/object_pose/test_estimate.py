from functools import cache

import numpy as np
import pytest
import trimesh
from object_pose_scenes import CAMERA, HERE, Scene, scene

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector
from fungrasp.objects import ObjectModel, load_object
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.object_pose.estimate import estimate_object_pose
from fungrasp.perception.object_pose.pose_error import add, add_s

MUG = load_object("mug")
LIFTED = np.concatenate([[0.0, 0.0, 0.08], quaternion_from_rotation_vector(np.array([0.3, 0.2, 0.8]))])
BESIDE = np.array([0.05, 0.0, 0.06])


@cache
def mug_scene() -> Scene:
    return scene(MUG, LIFTED, BESIDE)


def surface(model: ObjectModel) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(model.mesh, 3000, seed=0)[0])


def test_with_a_mask() -> None:
    there = mug_scene()
    capture = there.capture.with_object(mask=there.mask)
    found = estimate_object_pose(capture, MUG)
    assert add_s(surface(MUG), found.pose_camera_object, there.pose) < 0.004
    assert found.accepted
    assert found.note == ""
    assert found.residual_m < 0.003
    again = estimate_object_pose(capture, MUG)
    assert again.pose_camera_object.tobytes() == found.pose_camera_object.tobytes()
    assert again.score == found.score


def test_with_a_hand_and_no_mask() -> None:
    there = mug_scene()
    found = estimate_object_pose(there.capture, MUG, there.hand)
    assert add_s(surface(MUG), found.pose_camera_object, there.pose) < 0.006
    assert found.accepted


def test_another_objects_mesh_is_not_accepted() -> None:
    there = mug_scene()
    found = estimate_object_pose(
        there.capture.with_object(mask=there.mask), load_object("hammer"), there.hand
    )
    assert not found.accepted
    assert found.note.startswith("low confidence: ")


def test_a_mesh_in_millimetres_is_said() -> None:
    there = mug_scene()
    large = trimesh.Trimesh(MUG.vertices * 1000, MUG.faces, process=False)
    found = estimate_object_pose(there.capture, large, there.hand)
    assert (found.accepted, found.score) == (False, 0.0)
    assert "in millimetres?" in found.note


def test_a_mesh_much_smaller_than_the_mask_is_said() -> None:
    there = mug_scene()
    small = trimesh.Trimesh(MUG.vertices * 0.4, MUG.faces, process=False)
    found = estimate_object_pose(there.capture.with_object(mask=there.mask), small)
    assert not found.accepted
    assert "wrong mesh, mask or unit?" in found.note


def test_an_object_out_of_view_is_not_accepted() -> None:
    there = scene(MUG, compose(np.array([3.0, 0.0, 0.0, 1.0, 0, 0, 0]), LIFTED), BESIDE)
    found = estimate_object_pose(there.capture, MUG, there.hand)
    assert not found.accepted
    assert found.note


def test_too_few_pixels_are_said() -> None:
    there = mug_scene()
    rows, columns = np.nonzero(there.mask)
    few = np.zeros_like(there.mask)
    few[rows[:30], columns[:30]] = True
    found = estimate_object_pose(there.capture.with_object(mask=few), MUG, there.hand)
    assert (found.accepted, found.score) == (False, 0.0)
    assert "the mask has only 30 pixels with depth" in found.note


def test_a_mesh_without_faces_is_an_error() -> None:
    there = mug_scene()
    nothing = trimesh.Trimesh([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], np.empty((0, 3), int), process=False)
    with pytest.raises(FungraspError, match="no faces"):
        estimate_object_pose(there.capture, nothing)


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_color_tells_which_way_round(turn: float) -> None:
    box = trimesh.creation.box((0.12, 0.07, 0.03)).subdivide().subdivide().subdivide()
    end = np.where(box.vertices[:, :1] > 0.02, [[220, 40, 40, 255]], [[40, 80, 200, 255]])
    painted = trimesh.Trimesh(box.vertices, box.faces, process=False, vertex_colors=end.astype(np.uint8))
    yaw = quaternion_from_rotation_vector(np.array([0.0, 0.0, 0.4 + turn]))
    there = scene(painted, np.concatenate([[0.0, 0.0, 0.015], yaw]), np.array([0.3, 0.0, 0.0]))
    color = there.capture.color.copy()
    across = there.capture.points()[there.mask] - there.pose[:3]
    along = across @ compose(there.pose, np.array([1.0, 0, 0, 1, 0, 0, 0]))[:3] - across @ there.pose[:3]
    color[there.mask] = np.where(along[:, None] > 0.02, [140, 30, 30], [30, 60, 130])
    capture = Capture(color, there.capture.depth, there.capture.intrinsics, there.mask)
    found = estimate_object_pose(capture, painted)
    points = np.asarray(painted.vertices)
    assert add_s(points, found.pose_camera_object, there.pose) < 0.004
    red = np.array([[0.06, 0.0, 0.0]])
    assert add(red, found.pose_camera_object, there.pose) < 0.006
    half_turn = compose(there.pose, np.array([0.0, 0, 0, 0, 0, 0, 1]))
    others = [add(red, pose, half_turn) for pose, _ in found.alternatives]
    assert min(others) < 0.006, "the other way round is kept as an alternative"


def test_a_large_image_gives_the_same_pose() -> None:
    there = mug_scene()
    k, times = CAMERA, 5
    lens = Intrinsics(k.width * times, k.height * times, *(times * v for v in (k.fx, k.fy, k.cx, k.cy)))
    enlarged = [np.kron(a, np.ones((times, times), a.dtype)) for a in (there.capture.depth, there.mask)]
    color = np.full((*enlarged[0].shape, 3), 120, np.uint8)
    found = estimate_object_pose(Capture(color, enlarged[0], lens, enlarged[1]), MUG)
    assert add_s(surface(MUG), found.pose_camera_object, there.pose) < 0.004


def test_pose_is_that_of_the_objects_frame() -> None:
    shifted = trimesh.Trimesh(MUG.vertices + np.array([0.03, 0.0, -0.02]), MUG.faces, process=False)
    there = mug_scene()
    found = estimate_object_pose(there.capture.with_object(mask=there.mask), shifted)
    back = compose(found.pose_camera_object, np.concatenate([[0.03, 0.0, -0.02], HERE[3:]]))
    assert add_s(surface(MUG), back, there.pose) < 0.004
