"""Poses agree with SciPy's rotations and with themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from fungrasp.geometry import poses

settings.register_profile("poses", deadline=None)
settings.load_profile("poses")

numbers = st.floats(-2.0, 2.0, allow_subnormal=False)
vectors = arrays(np.float64, (5, 3), elements=numbers)
quaternions = (
    arrays(np.float64, (5, 4), elements=st.floats(-1.0, 1.0, allow_subnormal=False))
    .filter(lambda q: bool(np.all(np.linalg.norm(q, axis=-1) > 0.1)))
    .map(lambda q: q / np.linalg.norm(q, axis=-1, keepdims=True))
)
transforms = st.tuples(vectors, quaternions).map(lambda parts: np.concatenate(parts, axis=-1))
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def scipy_rotation(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def assert_same_rotation(a: np.ndarray, b: np.ndarray, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(np.abs(np.sum(a * b, axis=-1)), 1.0, atol=atol)


@given(quaternions, quaternions, vectors)
def test_rotations_agree_with_scipy(a: np.ndarray, b: np.ndarray, v: np.ndarray):
    np.testing.assert_allclose(poses.rotate(a, v), scipy_rotation(a).apply(v), atol=1e-12)
    np.testing.assert_allclose(poses.rotation_matrix(a), scipy_rotation(a).as_matrix(), atol=1e-12)
    product = (scipy_rotation(a) * scipy_rotation(b)).as_quat(scalar_first=True)
    assert_same_rotation(poses.quaternion_multiply(a, b), product)


@given(vectors)
def test_exponential_map_agrees_with_scipy(v: np.ndarray):
    expected = Rotation.from_rotvec(v).as_quat(scalar_first=True)
    assert_same_rotation(poses.quaternion_from_rotation_vector(v), expected)


@given(quaternions)
def test_logarithm_is_the_shorter_way_round(q: np.ndarray):
    v = poses.rotation_vector(q)
    assert np.all(np.linalg.norm(v, axis=-1) <= np.pi + 1e-12)
    np.testing.assert_allclose(np.linalg.norm(v, axis=-1), scipy_rotation(q).magnitude(), atol=1e-7)
    assert_same_rotation(poses.quaternion_from_rotation_vector(v), q)
    np.testing.assert_allclose(
        poses.rotation_vector(-q)[np.abs(q[:, 0]) > 1e-6], v[np.abs(q[:, 0]) > 1e-6], atol=1e-9
    )


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-7, 1e-3, np.pi - 1e-6, np.pi])
def test_maps_are_inverse_at_small_and_large_angles(angle: float):
    v = angle * np.array([[2.0, -1.0, 2.0]]) / 3
    back = poses.rotation_vector(poses.quaternion_from_rotation_vector(v))
    np.testing.assert_allclose(back, v, atol=1e-14 + 1e-9 * angle)


@given(quaternions, quaternions, st.floats(0.0, 1.0))
def test_turning_towards_goes_the_shorter_way_and_no_farther(q: np.ndarray, goal: np.ndarray, share: float):
    way = (scipy_rotation(goal) * scipy_rotation(q).inv()).as_rotvec()
    angle = np.linalg.norm(way, axis=1, keepdims=True)
    clear = angle[:, 0] < np.pi - 1e-3
    expected = (Rotation.from_rotvec(share * way) * scipy_rotation(q)).as_quat(scalar_first=True)
    found = poses.turned_towards(q, goal, np.stack([share * angle, angle + 1.0]))
    assert_same_rotation(found[0][clear], expected[clear])
    assert_same_rotation(found[1], goal)


@given(transforms, transforms, transforms)
def test_composition_is_associative(a: np.ndarray, b: np.ndarray, c: np.ndarray):
    left, right = poses.compose(poses.compose(a, b), c), poses.compose(a, poses.compose(b, c))
    np.testing.assert_allclose(left[:, :3], right[:, :3], atol=1e-9)
    assert_same_rotation(left[:, 3:], right[:, 3:])


@given(transforms, vectors)
def test_inverse_undoes(pose: np.ndarray, v: np.ndarray):
    both = poses.compose(pose, poses.invert(pose))
    np.testing.assert_allclose(both, np.broadcast_to(IDENTITY, both.shape), atol=1e-9)
    there = poses.transform_points(pose, v[:, None])
    np.testing.assert_allclose(poses.inverse_transform_points(pose, there)[:, 0], v, atol=1e-9)
    np.testing.assert_allclose(poses.transform_points(poses.invert(pose), there)[:, 0], v, atol=1e-9)


@given(transforms, transforms, vectors)
def test_composition_maps_points_one_after_the_other(a: np.ndarray, b: np.ndarray, v: np.ndarray):
    at_once = poses.transform_points(poses.compose(a, b), v[:, None])
    np.testing.assert_allclose(
        at_once, poses.transform_points(a, poses.transform_points(b, v[:, None])), atol=1e-9
    )


@given(transforms, transforms)
def test_a_pose_seen_from_another_leads_back_to_it(a: np.ndarray, b: np.ndarray):
    seen = poses.relative(a, b)
    np.testing.assert_allclose(seen, poses.compose(poses.invert(a), b), atol=1e-12)
    np.testing.assert_allclose(poses.compose(a, seen), b, atol=1e-12)


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@given(quaternions)
def test_euler_angles_agree_with_scipy(q: np.ndarray):
    angles = poses.euler_angles(q)
    assert np.all(np.abs(angles) <= np.array([np.pi, np.pi / 2, np.pi]) + 1e-12)
    again = Rotation.from_euler("XYZ", angles).as_quat(scalar_first=True)
    assert_same_rotation(again, q)
    clear = np.abs(angles[:, 1]) < np.pi / 2 - 1e-3
    expected = scipy_rotation(q).as_euler("XYZ")
    difference = (angles - expected)[clear]
    np.testing.assert_allclose(np.sin(difference / 2), 0.0, atol=1e-9)


@pytest.mark.parametrize("tilt", [-np.pi / 2, np.pi / 2, -np.pi / 2 + 1e-9, np.pi / 2 - 1e-5])
def test_euler_angles_at_a_right_angle_make_the_same_rotation(tilt: float):
    q = Rotation.from_euler("XYZ", [[0.3, tilt, -2.0], [3.0, tilt, 1.0]]).as_quat(scalar_first=True)
    again = Rotation.from_euler("XYZ", poses.euler_angles(q)).as_quat(scalar_first=True)
    assert_same_rotation(again, q)


@given(transforms, transforms)
def test_one_pose_is_treated_as_many_to_the_last_bit(a: np.ndarray, b: np.ndarray):
    for work in (poses.compose, poses.relative):
        alone = np.concatenate([work(a[i : i + 1], b[i : i + 1]) for i in range(len(a))])
        np.testing.assert_array_equal(work(a, b), alone)
    for work in (poses.invert, lambda pose: poses.rotation_matrix(pose[:, 3:])):
        np.testing.assert_array_equal(work(a), np.concatenate([work(row[None]) for row in a]))


def test_torch_computes_the_same():
    torch = pytest.importorskip("torch")
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, 6, 7))
    a[:, 3:] /= np.linalg.norm(a[:, 3:], axis=1, keepdims=True)
    b[:, 3:] /= np.linalg.norm(b[:, 3:], axis=1, keepdims=True)
    for work in (
        poses.compose,
        poses.relative,
        lambda a, b: poses.invert(a),
        lambda a, b: poses.turned_towards(a[:, 3:], b[:, 3:], 0.1 + 0.0 * a[:, :1]),
        lambda a, b: poses.rotation_vector(a[:, 3:]),
        lambda a, b: poses.euler_angles(a[:, 3:]),
        lambda a, b: poses.rotation_matrix(a[:, 3:]),
        lambda a, b: poses.quaternion_from_rotation_vector(a[:, :3]),
    ):
        for kind, atol in ((torch.float64, 1e-12), (torch.float32, 1e-5)):
            result = work(torch.as_tensor(a, dtype=kind), torch.as_tensor(b, dtype=kind))
            assert result.dtype == kind
            np.testing.assert_allclose(result.numpy(), work(a, b), atol=atol)


def test_single_precision_stays_single():
    a = np.tile(IDENTITY, (3, 1)).astype(np.float32)
    assert poses.compose(a, a).dtype == poses.rotation_matrix(a[:, 3:]).dtype == np.float32
    assert poses.rotation_vector(a[:, 3:]).dtype == poses.euler_angles(a[:, 3:]).dtype == np.float32


def test_shapes_broadcast():
    one, many = IDENTITY.copy(), np.tile(IDENTITY, (4, 2, 1))
    assert poses.compose(one, many).shape == (4, 2, 7)
    assert poses.compose(many, one).shape == (4, 2, 7)
    assert poses.transform_points(many, np.zeros((9, 3))).shape == (4, 2, 9, 3)
    np.testing.assert_array_equal(poses.cross(np.eye(3)[0], np.eye(3)), np.cross(np.eye(3)[0], np.eye(3)))
