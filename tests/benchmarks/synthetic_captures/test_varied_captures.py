"""Left hands, and captures as a validation set."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import KDTree

from benchmarks.perception.capture_files import render_set, write_capture
from benchmarks.perception.recorded_captures import read_recorded
from benchmarks.synthetic_captures.capture_scene import Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.render_capture import hovering, render_capture
from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.grasps import builtin_grasps
from fungrasp.objects import builtin_object, mirrored_object
from fungrasp.perception import Intrinsics
from fungrasp.perception.hand.physical_evidence import link_gaps

LENS = Intrinsics(320, 240, 300, 300, 160, 119)
PLAIN = CaptureSettings(
    intrinsics=LENS, intrinsics_spread=4.0, depth_noise=(), color_noise=None, distance=(0.4, 0.5)
)
GRASP = builtin_grasps()[0]
MODEL = builtin_object(GRASP.object_name)


def rendered(settings: CaptureSettings, seed: int = 3):
    return render_capture(GRASP, MODEL, np.random.default_rng(seed), settings)


@pytest.mark.parametrize("gap", [0.005, 0.04])
def test_a_hovering_hand_is_away_from_the_object_by_the_gap(gap):
    seen = hovering(GRASP, MODEL, gap)
    nearest = link_gaps(seen.hand_joints, MODEL.signed_distance, seen.object_pose).min()
    assert gap <= nearest < gap + 0.002 and not seen.link_contacts.any()
    assert link_gaps(GRASP.hand_joints, MODEL.signed_distance, GRASP.object_pose).min() < gap


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


def test_a_validation_set_is_rendered_once(tmp_path):
    settings = dataclasses.replace(PLAIN, left=1.0)
    grasps = builtin_grasps().select(builtin_grasps().object_name == MODEL.name)
    render_set(tmp_path, grasps, {MODEL.name: MODEL}, 0, 8, settings)
    known = read_recorded(tmp_path / "8_0000")
    assert known.model is not None and known.pose_camera_object is not None
    mirrored = mirrored_object(MODEL).vertices
    np.testing.assert_allclose(known.model.vertices.min(0), mirrored.min(0), atol=1e-6)
    before = (tmp_path / "8_0000" / "rgb.png").stat().st_mtime_ns
    render_set(tmp_path, grasps, {MODEL.name: MODEL}, 0, 8, settings)
    assert (tmp_path / "8_0000" / "rgb.png").stat().st_mtime_ns == before
