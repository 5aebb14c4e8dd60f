import numpy as np
import pytest
import trimesh

from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.perception.object_pose.object_template import MeshRays

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
