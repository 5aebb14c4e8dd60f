"""Batched kinematics against MuJoCo itself and against differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import transform_points
from fungrasp.hands import hand_files, load_hand
from fungrasp.hands.collisions import collision_spheres
from fungrasp.hands.kinematics import BodyPoints, HandKinematics

HANDS = sorted(hand_files())
COUNT = 4


@pytest.fixture(params=HANDS)
def kinematics(request: pytest.FixtureRequest) -> HandKinematics:
    return HandKinematics(load_hand(request.param), COUNT)


def random_state(kinematics: HandKinematics, inside: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    """Wrist poses and independent joints away from their limits."""
    random = np.random.default_rng(0)
    rotation = Rotation.random(COUNT, random).as_quat(scalar_first=True)
    pose = np.concatenate([random.uniform(-0.5, 0.5, (COUNT, 3)), rotation], axis=1)
    share = 0.5 + inside * random.uniform(-0.5, 0.5, (COUNT, len(kinematics.lower)))
    return pose, kinematics.lower + share * (kinematics.upper - kinematics.lower)


def posed(kinematics: HandKinematics, joints: np.ndarray) -> mujoco.MjData:
    """MuJoCo's own hand, palm at the world's origin. joints: independent, shape [U]."""
    data = mujoco.MjData(kinematics.model)
    data.qpos[:] = kinematics.matrix @ joints + kinematics.offset
    mujoco.mj_kinematics(kinematics.model, data)
    mujoco.mj_comPos(kinematics.model, data)
    return data


def palm_to_model(kinematics: HandKinematics, data: mujoco.MjData) -> np.ndarray:
    palm = data.body(kinematics.hand.palm)
    return np.concatenate([palm.xpos, palm.xquat])


def test_without_a_pose_the_palm_is_the_frame(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    pose[:] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    points = kinematics.body_points(kinematics.hand.keypoint_names)
    kinematics.update(pose, joints)
    expected = kinematics.points(points), kinematics.jacobian(points.bodies, kinematics.points(points))
    kinematics.update(None, joints)
    np.testing.assert_array_equal(kinematics.points(points), expected[0])
    np.testing.assert_array_equal(kinematics.jacobian(points.bodies, expected[0]), expected[1])


def test_points_are_where_mujoco_has_them(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    points = collision_spheres(kinematics.hand, 0.02).points
    kinematics.update(pose, joints)
    found = kinematics.points(points)
    for row in range(COUNT):
        data = posed(kinematics, joints[row])
        rotations = data.xmat[points.bodies].reshape(-1, 3, 3)
        model = data.xpos[points.bodies] + np.einsum("pij,pj->pi", rotations, points.offsets)
        palm = palm_to_model(kinematics, data)
        in_palm = (model - palm[:3]) @ data.body(kinematics.hand.palm).xmat.reshape(3, 3)
        np.testing.assert_allclose(found[row], transform_points(pose[row], in_palm), atol=1e-9)


def test_joint_columns_equal_mj_jac(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    points = kinematics.body_points(kinematics.hand.keypoint_names)
    kinematics.update(pose, joints)
    positions = kinematics.points(points)
    jacobian = kinematics.jacobian(points.bodies, positions)
    assert jacobian.shape == (COUNT, len(points.bodies), 3, kinematics.size)
    for row in range(COUNT):
        data = posed(kinematics, joints[row])
        to_reference = (
            Rotation.from_quat(pose[row, 3:], scalar_first=True).as_matrix()
            @ data.body(kinematics.hand.palm).xmat.reshape(3, 3).T
        )
        for p, (body, offset) in enumerate(zip(points.bodies, points.offsets, strict=True)):
            position = data.xpos[body] + data.xmat[body].reshape(3, 3) @ offset
            full = np.zeros((3, kinematics.model.nv))
            mujoco.mj_jac(kinematics.model, data, full, None, position, body)
            np.testing.assert_allclose(
                jacobian[row, p, :, 6:], to_reference @ full @ kinematics.matrix, atol=1e-9
            )


def test_jacobian_is_the_derivative_along_steps(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    points = kinematics.body_points(kinematics.hand.keypoint_names)
    kinematics.update(pose, joints)
    jacobian = kinematics.jacobian(points.bodies, kinematics.points(points))
    h = 1e-6
    for direction in range(kinematics.size):
        ends = []
        for sign in (1, -1):
            tangent = np.zeros((COUNT, kinematics.size))
            tangent[:, direction] = sign * h
            kinematics.update(*kinematics.step(pose, joints, tangent))
            ends.append(kinematics.points(points))
        np.testing.assert_allclose(jacobian[..., direction], (ends[0] - ends[1]) / (2 * h), atol=1e-7)


def test_bodies_may_differ_from_row_to_row(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    points = kinematics.body_points(kinematics.hand.keypoint_names)
    kinematics.update(pose, joints)
    positions = kinematics.points(points)
    every = kinematics.jacobian(points.bodies, positions)
    random = np.random.default_rng(1)
    which = random.integers(0, len(points.bodies), (COUNT, 5))
    picked = kinematics.jacobian(
        points.bodies[which], np.take_along_axis(positions, which[..., None], axis=1)
    )
    for row in range(COUNT):
        np.testing.assert_array_equal(picked[row], every[row, which[row]])


def test_steps_stay_within_limits_and_on_the_unit_sphere(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    tangent = np.random.default_rng(2).normal(scale=3.0, size=(COUNT, kinematics.size))
    new_pose, new_joints = kinematics.step(pose, joints, tangent)
    np.testing.assert_allclose(np.linalg.norm(new_pose[:, 3:], axis=1), 1.0, atol=1e-12)
    assert np.all((new_joints >= kinematics.lower) & (new_joints <= kinematics.upper))
    np.testing.assert_allclose(new_pose[:, :3], pose[:, :3] + tangent[:, :3])
    expected = Rotation.from_rotvec(tangent[:, 3:6]) * Rotation.from_quat(pose[:, 3:], scalar_first=True)
    turn = expected.inv() * Rotation.from_quat(new_pose[:, 3:], scalar_first=True)
    np.testing.assert_allclose(turn.magnitude(), 0.0, atol=1e-9)


def test_independent_limits_keep_coupled_joints_within_theirs(kinematics: HandKinematics):
    limits = kinematics.hand.joint_limits
    for corner in (kinematics.lower, kinematics.upper):
        full = kinematics.matrix @ corner + kinematics.offset
        assert np.all((full >= limits[:, 0] - 1e-9) & (full <= limits[:, 1] + 1e-9))
    for u in range(len(kinematics.upper)):
        beyond = kinematics.upper.copy()
        beyond[u] += 1e-3
        full = kinematics.matrix @ beyond + kinematics.offset
        assert np.any((full > limits[:, 1]) | (full < limits[:, 0])), "the limit could be wider"


def test_keypoints_of_full_joint_vectors(kinematics: HandKinematics):
    pose, joints = random_state(kinematics)
    full = joints @ kinematics.matrix.T + kinematics.offset
    found = kinematics.keypoints(pose, full)
    assert found.shape == (COUNT, len(kinematics.hand.keypoint_names), 3)
    np.testing.assert_allclose(found[:, 0], pose[:, :3], atol=1e-9)
    kinematics.update(pose, joints)
    np.testing.assert_allclose(
        found, kinematics.points(kinematics.body_points(kinematics.hand.keypoint_names)), atol=1e-9
    )


def test_sites_and_bodies_are_found_by_name():
    kinematics = HandKinematics(load_hand("allegro"), 1)
    points = kinematics.body_points(("ff_proximal", "ff_tip_centre"))
    model = kinematics.model
    assert [model.body(int(b)).name for b in points.bodies] == ["ff_proximal", "ff_distal"]
    np.testing.assert_array_equal(points.offsets[0], 0)
    np.testing.assert_array_equal(points.offsets[1], model.site("ff_tip_centre").pos)
    some = points[np.array([1])]
    assert isinstance(some, BodyPoints)
    np.testing.assert_array_equal(some.offsets, points.offsets[1:])
