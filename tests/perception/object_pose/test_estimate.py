from functools import cache

import numpy as np
import pytest
import trimesh
from object_pose_scenes import CAMERA, HERE, Scene, scene
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, transform_points
from fungrasp.objects import ObjectModel, load_object
from fungrasp.objects.object_variants import scaled_object
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.acceptance import object_help
from fungrasp.perception.io.estimates import PoseEvidence
from fungrasp.perception.object_pose import object_template as known_object_module
from fungrasp.perception.object_pose.estimate import estimate_object_pose
from fungrasp.perception.object_pose.object_template import object_template
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
    again = estimate_object_pose(capture, MUG)
    assert again.pose_camera_object.tobytes() == found.pose_camera_object.tobytes()
    assert again.score == found.score


def test_a_mesh_in_millimeters_is_said() -> None:
    there = mug_scene()
    large = trimesh.Trimesh(MUG.vertices * 1000, MUG.faces, process=False)
    found = estimate_object_pose(there.capture, large, there.hand)
    assert (found.accepted, found.score) == (False, 0.0)
    assert "in millimeters?" in found.note


def test_a_mesh_much_smaller_than_the_mask_is_said() -> None:
    there = mug_scene()
    small = trimesh.Trimesh(MUG.vertices * 0.4, MUG.faces, process=False)
    found = estimate_object_pose(there.capture.with_object(mask=there.mask), small)
    assert not found.accepted
    assert "wrong mesh, mask or unit?" in found.note


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


def test_a_mesh_of_another_size_is_known_by_the_size_that_fits() -> None:
    there = mug_scene()
    capture = there.capture.with_object(mask=there.mask)
    right = estimate_object_pose(capture, MUG, there.hand).evidence
    assert right is not None and right.other_size < -0.1
    for factor in (0.67, 1.4):
        found = estimate_object_pose(capture, scaled_object(MUG, factor), there.hand)
        assert found.evidence is not None and not found.accepted
        assert found.evidence.other_size > 0.1


def test_a_loose_mask_and_smoothed_depth_are_measured() -> None:
    there = mug_scene()
    color = np.where(there.mask[..., None], [40, 80, 160], [150, 110, 80]).astype(np.uint8)
    tight = Capture(color, there.capture.depth, there.capture.intrinsics, there.mask)
    loose = tight.with_object(mask=ndimage.binary_dilation(there.mask, iterations=10))
    depth = ndimage.uniform_filter(there.capture.depth, 9).astype(np.float32)
    smooth = Capture(color, depth, tight.intrinsics, tight.mask)
    hammer = load_object("hammer")

    def found(capture: Capture) -> tuple[PoseEvidence, str]:
        obj = estimate_object_pose(capture, hammer, there.hand)
        assert obj.evidence is not None and not obj.accepted
        return obj.evidence, "; ".join(object_help(obj))

    evidence, words = found(loose)
    # Half of the mask is not the object; not all of that looks foreign.
    assert 0.25 < evidence.foreign < 0.55 and "a tighter mask" in words
    evidence, words = found(smooth)
    assert 7 <= evidence.edge_width <= 11 and "filters turned off" in words
    evidence, words = found(tight)
    assert evidence.foreign < 0.25 and evidence.edge_width < 6
    assert "tighter" not in words and "filters" not in words


def test_what_is_found_out_about_a_mesh_is_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path))
    known_object_module._known.cache_clear()
    first = object_template(MUG)
    known_object_module._known.cache_clear()
    monkeypatch.setattr(known_object_module, "_even_samples", None)
    again = object_template(MUG)
    assert again is not first
    for before, now in (
        (first.surface.samples, again.surface.samples),
        (first.normals, again.normals),
        (first.symmetries, again.symmetries),
    ):
        np.testing.assert_array_equal(before, now)
    known_object_module._known.cache_clear()


def test_a_mug_comes_to_itself_about_the_axis_of_its_body() -> None:
    # The handle is at the upper end of x; at the lower one, the round body is as wide as in y.
    body = np.array([MUG.vertices[:, 0].min() + MUG.vertices[:, 1].max(), 0.0, 0.0])
    turns = object_template(MUG).symmetries
    moved = transform_points(turns, np.tile(body, (len(turns), 1, 1)))[:, 0]
    about_body = np.linalg.norm(moved - body, axis=1) < 0.009
    angles = np.degrees(2 * np.arccos(np.clip(np.abs(turns[about_body, 3]), 0, 1)))
    assert {90, 180} <= {round(angle) for angle in angles.tolist()}
