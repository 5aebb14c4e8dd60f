"""Left hands, rings, watches, other people, and captures without a hand."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import KDTree

from benchmarks.perception.capture_files import write_capture
from benchmarks.perception.no_hand_capture import no_hand_capture
from benchmarks.perception.recorded_captures import read_recorded, recorded_folders
from benchmarks.perception.scene_additions import MoreInTheImage, varied_settings
from benchmarks.perception.varied import render_varied
from benchmarks.synthetic_captures.capture_scene import Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.render_capture import render_capture
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.grasps import builtin_grasps
from fungrasp.objects import builtin_object, mirrored_object
from fungrasp.perception import Intrinsics

LENS = Intrinsics(320, 240, 300, 300, 160, 119)
PLAIN = CaptureSettings(
    intrinsics=LENS, intrinsics_spread=4.0, depth_noise=None, color_noise=None, distance=(0.4, 0.5)
)
GRASP = builtin_grasps()[0]
MODEL = builtin_object(GRASP.object_name)


def rendered(settings: CaptureSettings, seed: int = 3):
    return render_capture(GRASP, MODEL, np.random.default_rng(seed), settings)


@pytest.fixture(scope="module")
def left():
    return rendered(dataclasses.replace(PLAIN, left=1.0))


def test_a_left_hand_is_the_mirror_image_of_a_right_one(left):
    right = rendered(PLAIN)
    assert (left.side, right.side) == ("left", "right")
    np.testing.assert_array_equal(left.labels, right.labels[:, ::-1])
    np.testing.assert_array_equal(left.capture.depth, right.capture.depth[:, ::-1])
    seen, other = (s.capture.intrinsics.project(s.joints_camera) for s in (left, right))
    np.testing.assert_allclose(seen[:, 1], other[:, 1], atol=1e-9)
    np.testing.assert_allclose(seen[:, 0], 319 - other[:, 0], atol=1e-9)


def test_the_truth_of_a_left_hand_fits_the_picture(left):
    """The mirrored mesh at the true pose is where the depth was measured."""
    model = mirrored_object(MODEL)
    points = left.capture.points()[left.object_mask]
    assert len(points) > 100
    local = inverse_transform_points(left.pose_camera_object, points[::5])
    surface = model.mesh.sample(60_000)
    assert KDTree(surface).query(local)[0].max() < 0.004
    vertices = transform_points(left.pose_camera_object, left.painted.vertices)
    assert KDTree(vertices).query(points[::5])[0].max() < 0.008, "the painted mesh is mirrored as well"


def test_a_written_capture_is_one_of_a_validation_set(left, tmp_path):
    write_capture(left, tmp_path / "left", mirrored_object(MODEL))
    known = read_recorded(tmp_path / "left")
    assert known.model is not None and known.capture.mask is not None and known.colored is None
    np.testing.assert_array_equal(known.capture.mask, left.object_mask)
    np.testing.assert_allclose(known.pose_camera_object, left.pose_camera_object)
    np.testing.assert_allclose(known.joints_camera, left.joints_camera)
    assert known.joint_pixels is not None and 3 < np.isfinite(known.joint_pixels[:, 0]).sum() <= 21
    table = left.capture.points()[left.labels == Label.TABLE]
    assert known.table is not None and np.abs(table @ known.table[:3] + known.table[3]).max() < 0.001


def test_rings_watches_and_people_are_seen_and_nothing_else_changes():
    bare = rendered(PLAIN)
    dressed = rendered(dataclasses.replace(PLAIN, additions=MoreInTheImage(worn=1.0)))
    assert (dressed.labels == Label.WORN).sum() > 20
    np.testing.assert_array_equal(dressed.pose_world_camera, bare.pose_world_camera)
    elsewhere = dressed.labels != bare.labels
    assert elsewhere.mean() < 0.05, "a ring and a watch are small"
    far = dataclasses.replace(
        PLAIN, additions=MoreInTheImage(people=1.0), distance=(0.8, 0.9), elevation=(15, 20)
    )
    peopled = rendered(far)
    assert (peopled.labels == Label.PERSON).sum() > 200
    assert (peopled.labels == Label.HAND).sum() > 50


def test_images_without_a_hand_have_the_same_bytes_again():
    settings = dataclasses.replace(varied_settings(), intrinsics=LENS)
    seen, words = no_hand_capture(5, 1, settings)
    again, _ = no_hand_capture(5, 1, settings)
    assert "hand" in words, "a robot's"
    np.testing.assert_array_equal(seen.color, again.color)
    np.testing.assert_array_equal(seen.depth, again.depth)
    assert seen.measured.mean() > 0.3
    other, words = no_hand_capture(5, 0, settings)
    assert "person" in words and (other.color != seen.color).mean() > 0.5


def test_parts_are_from_0_to_1():
    with pytest.raises(FungraspError, match="worn is a part, from 0 to 1"):
        MoreInTheImage(worn=1.5)


def test_a_validation_set_is_rendered_once(tmp_path):
    """The captures of the command ``bench perception --varied``."""
    settings = dataclasses.replace(PLAIN, left=1.0)
    grasps = builtin_grasps().select(builtin_grasps().object_name == MODEL.name)
    render_varied(tmp_path, grasps, {MODEL.name: MODEL}, 1, 8, settings)
    hand, none = recorded_folders(tmp_path)
    known, empty = read_recorded(hand), read_recorded(none)
    assert known.model is not None and known.pose_camera_object is not None and empty.model is None
    mirrored = mirrored_object(MODEL).vertices
    np.testing.assert_allclose(known.model.vertices.min(0), mirrored.min(0), atol=1e-6)
    before = [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("*/rgb.png"))]
    render_varied(tmp_path, grasps, {MODEL.name: MODEL}, 1, 8, settings)
    assert [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("*/rgb.png"))] == before
