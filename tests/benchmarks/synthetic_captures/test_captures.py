import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from benchmarks.perception.capture_files import write_capture
from benchmarks.perception.recorded_captures import read_recorded
from benchmarks.synthetic_captures.capture_scene import Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.render_capture import capture_at, render_capture
from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.mesh_file import read_colored_mesh
from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.grasps import builtin_grasps, load_human_grasps
from fungrasp.objects import builtin_object, load_object
from fungrasp.perception import Intrinsics

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared"

SMALL = CaptureSettings(intrinsics=Intrinsics(320, 240, 300, 300, 160, 119), intrinsics_spread=4.0)
PERFECT = dataclasses.replace(SMALL, depth_noise=(), color_noise=None)


def captures(count: int, seed: int, settings: CaptureSettings = SMALL):
    grasps = builtin_grasps()
    objects = {name: builtin_object(name) for name in np.unique(grasps.object_name).tolist()}
    return [capture_at(i, grasps, objects, seed, settings) for i in range(count)]


@pytest.fixture(scope="module")
def perfect():
    return captures(3, 4, PERFECT)


@pytest.fixture(scope="module")
def noisy():
    return captures(3, 4)


def test_the_object_is_where_the_truth_says(perfect):
    for synthetic in perfect:
        model = builtin_object(synthetic.grasp.object_name)
        points = synthetic.capture.points()[synthetic.object_mask]
        assert len(points) > 100
        local = inverse_transform_points(synthetic.pose_camera_object, points[::7])
        surface, face = trimesh.sample.sample_surface(model.mesh, 100_000, seed=0)
        distance, nearest = KDTree(surface).query(local)
        assert distance.max() < 0.004
        away = np.abs(np.sum((local - surface[nearest]) * model.mesh.face_normals[face[nearest]], axis=-1))
        assert np.median(away) < 1e-5


def test_the_joints_are_where_the_truth_says(perfect):
    for synthetic in perfect:
        world = transform_points(synthetic.pose_world_camera, synthetic.joints_camera)
        np.testing.assert_allclose(world, synthetic.grasp.hand_joints, atol=1e-9)
        pixels = synthetic.capture.intrinsics.project(synthetic.joints_camera)
        assert ((pixels > 0) & (pixels < [320, 240])).all()
        columns, rows = np.round(pixels).astype(int).T
        depth, label = synthetic.capture.depth[rows, columns], synthetic.labels[rows, columns]
        skin = label == Label.HAND
        assert skin.sum() >= 5
        # Skin covers its joints: the nearest ones by a few millimeters, those behind the palm by more.
        cover = (synthetic.joints_camera[:, 2] - depth)[skin]
        assert (cover > -0.004).all()
        assert cover.min() < 0.015


def test_noise_is_that_of_a_depth_camera(perfect, noisy):
    for clean, synthetic in zip(perfect, noisy, strict=True):
        np.testing.assert_array_equal(clean.labels, synthetic.labels)
        depth, true = synthetic.capture.depth, clean.capture.depth
        np.testing.assert_allclose(depth * 1000, np.round(depth * 1000), atol=1e-3)
        measured = synthetic.capture.measured
        assert 0.02 < (~measured).mean() < 0.5
        near = measured & (true < 1.2) & (synthetic.labels == Label.TABLE)
        # An error of calibration is one for the image, with a standard deviation of 0.4 % of the depth.
        scale = np.median(depth[near] / true[near])
        assert abs(scale - 1) < 3 * 0.004
        error = depth[near] / scale - true[near]
        assert abs(np.median(error)) < 1e-3
        assert 2e-4 < np.median(np.abs(error)) < 6e-3
        assert not np.array_equal(clean.capture.color, synthetic.capture.color)


def test_the_same_seed_gives_the_same_bytes_whatever_the_count(noisy):
    again = captures(1, 4)[0]
    other = captures(1, 5)[0]
    np.testing.assert_array_equal(again.capture.color, noisy[0].capture.color)
    np.testing.assert_array_equal(again.capture.depth, noisy[0].capture.depth)
    np.testing.assert_array_equal(again.labels, noisy[0].labels)
    assert not np.array_equal(other.capture.color, noisy[0].capture.color)


def test_every_grasp_has_its_turn():
    grasps = builtin_grasps().select(slice(3))
    objects = {name: builtin_object(name) for name in np.unique(grasps.object_name).tolist()}
    tiny = dataclasses.replace(PERFECT, intrinsics=Intrinsics(64, 48, 60, 60, 32, 24))
    poses = [capture_at(i, grasps, objects, 1, tiny).grasp.object_pose for i in range(6)]
    for turn in (poses[:3], poses[3:]):
        found = sorted(pose.tolist() for pose in turn)
        assert found == sorted(grasps.object_pose.tolist())


def test_hand_and_object_are_both_to_be_seen(noisy):
    for synthetic in noisy:
        assert synthetic.object_mask.mean() > 0.005
        assert synthetic.hand_mask.mean() > 0.01
        color = synthetic.capture.color[synthetic.hand_mask].astype(int)
        assert (color[:, 0] > color[:, 2]).mean() > 0.9


def test_what_was_written_is_read_again(noisy, tmp_path):
    synthetic = noisy[0]
    name = synthetic.grasp.object_name
    write_capture(synthetic, tmp_path, builtin_object(name))
    read = read_recorded(tmp_path)
    np.testing.assert_array_equal(read.capture.color, synthetic.capture.color)
    np.testing.assert_allclose(read.capture.depth, synthetic.capture.depth, atol=1e-6)
    assert read.capture.intrinsics == synthetic.capture.intrinsics
    np.testing.assert_array_equal(read.capture.mask, synthetic.object_mask)
    np.testing.assert_allclose(read.pose_camera_object, synthetic.pose_camera_object, atol=1e-12)
    np.testing.assert_allclose(read.joints_camera, synthetic.joints_camera, atol=1e-12)
    # The mesh that perception is given is the object itself, with its paint.
    painted = read_colored_mesh(tmp_path / f"{name}.ply")
    assert painted is not None
    np.testing.assert_allclose(painted.vertices, synthetic.painted.vertices, atol=1e-6)
    colors = np.asarray(painted.visual.vertex_colors)[:, :3] / 255  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(colors, synthetic.painted.colors, atol=0.003)
    mesh = load_object(name, 0.2, tmp_path)
    np.testing.assert_allclose(mesh.size, builtin_object(name).size, atol=1e-6)


@pytest.mark.parametrize(
    "changes", [{"distance": (0.9, 0.4)}, {"distance": (0.1, 0.4)}, {"elevation": (10, 90)}]
)
def test_impossible_settings_are_refused(changes):
    with pytest.raises(FungraspError, match="captures"):
        dataclasses.replace(SMALL, **changes)


def test_grasps_of_other_data_sets_and_their_meshes():
    data = SHARED / "data" / "dexycb_train.npz"
    if not data.is_file():
        pytest.skip("the human grasps of DexYCB are not here")
    grasp = load_human_grasps(data)[40]
    model = load_object(grasp.object_name, grasp.object_mass, SHARED / "data" / "ycb")
    synthetic = render_capture(grasp, model, np.random.default_rng(0), SMALL)
    assert synthetic.object_mask.sum() > 200
    assert synthetic.hand_mask.sum() > 500
