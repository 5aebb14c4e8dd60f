"""How wrong a pose is, and the rays that meet a mesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.perception.object_pose.object_template import MeshRays
from fungrasp.perception.object_pose.pose_error import add, add_s, rotation_error

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * 0.05
HOME = np.array([0.1, -0.2, 0.6, 1.0, 0.0, 0.0, 0.0])


def turned(axis: list[float], angle: float) -> np.ndarray:
    pose = HOME.copy()
    pose[3:] = quaternion_from_rotation_vector(np.array(axis) * angle)
    return pose


def shifted(pose: np.ndarray, *shift: float) -> np.ndarray:
    return np.concatenate([pose[:3] + np.array(shift), pose[3:]])


def test_a_shift_is_the_error() -> None:
    moved = shifted(HOME, 0.003, 0.0, 0.004)
    assert add(CORNERS, moved, HOME) == pytest.approx(0.005)
    assert add_s(CORNERS, moved, HOME) == pytest.approx(0.005)
    assert rotation_error(moved, HOME) == pytest.approx(0.0)


def test_a_symmetry_is_an_error_for_add_only() -> None:
    quarter = turned([0.0, 0.0, 1.0], np.pi / 2)
    assert add_s(CORNERS, quarter, HOME) == pytest.approx(0.0, abs=1e-9)
    assert add(CORNERS, quarter, HOME) == pytest.approx(0.1)
    assert rotation_error(quarter, HOME) == pytest.approx(np.pi / 2)


def test_add_s_goes_from_the_truth_to_the_estimate() -> None:
    # The estimate covers the true points and one more far away, which must not count.
    points = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    moved = shifted(HOME, 0.1, 0.0, 0.0)
    # True points at 0 and 0.1, estimated ones at 0.1 and 0.2.
    assert add_s(points, moved, HOME) == pytest.approx(0.05)


def test_batch_equals_loop() -> None:
    poses = np.stack([HOME, turned([1.0, 0, 0], 0.3), shifted(HOME, 0.01, 0.0, 0.0)])
    for error in (add, add_s):
        assert error(CORNERS, poses, HOME) == pytest.approx([error(CORNERS, pose, HOME) for pose in poses])


BOX = trimesh.creation.box((0.2, 0.1, 0.06))


def test_depth_of_a_box_seen_straight_on() -> None:
    rays = MeshRays(BOX.vertices, BOX.faces)
    pose = np.array([[0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]])
    directions = np.array([[0.0, 0.0, 1.0], [0.1, 0.05, 1.0], [0.3, 0.0, 1.0]])
    seen = rays.cast(pose, directions)
    assert seen[0, :2] == pytest.approx([0.47, 0.47])
    assert np.isinf(seen[0, 2])


def test_off_center_meshes_stay_where_they_are() -> None:
    # A mesh whose own center is far from its origin, turned by 90 degrees about y.
    rays = MeshRays(BOX.vertices + np.array([0.0, 0.0, 0.3]), BOX.faces)
    turned = np.concatenate([[-0.3, 0.0, 0.6], quaternion_from_rotation_vector(np.array([0, np.pi / 2, 0]))])
    seen = rays.cast(turned[None], np.array([[0.0, 0.0, 1.0]]))
    assert seen[0, 0] == pytest.approx(0.6 - 0.1)


def test_each_pose_has_its_own_image() -> None:
    rays = MeshRays(BOX.vertices, BOX.faces)
    poses = np.array([[0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0] for z in (0.4, 0.7, -0.5)])
    seen = rays.cast(poses, np.array([[0.0, 0.0, 1.0], [0.02, 0.0, 1.0]]))
    assert seen[:2] == pytest.approx(np.array([[0.37, 0.37], [0.67, 0.67]]))
    assert np.isinf(seen[2]).all(), "what is behind the camera is not seen"
