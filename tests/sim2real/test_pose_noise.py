"""Poses that are off, and objects that were moved on the table."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.sim2real import offset_pose, shift_on_table


def random_poses(seed: int, count: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=random).as_quat(scalar_first=True)
    return np.concatenate([random.normal(size=(count, 3)), turns], axis=1)


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rotation vector from orientation a to b in the frame of a [rad]."""
    first, second = (Rotation.from_quat(q, scalar_first=True) for q in (a, b))
    return (first.inv() * second).as_rotvec()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_an_offset_turns_about_the_center_and_moves_it_by_its_first_half(seed: int):
    random = np.random.default_rng(seed)
    pose, offset, center = random_poses(seed, 6), random.normal(size=(6, 6)), random.normal(size=(6, 3))
    result = offset_pose(pose, offset, center)
    before = transform_points(pose, center[:, None])[:, 0]
    after = transform_points(result, center[:, None])[:, 0]
    np.testing.assert_allclose(after, before + offset[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(result[:, 3:], axis=1), 1.0, atol=1e-12)
    at_origin = offset_pose(pose, offset)
    np.testing.assert_allclose(at_origin[:, :3], pose[:, :3] + offset[:, :3], atol=1e-12)
    small = offset * 0.3
    np.testing.assert_allclose(
        turned(pose[:, 3:], offset_pose(pose, small)[:, 3:]), _shortest(small[:, 3:]), atol=1e-9
    )


def _shortest(vector: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_rotvec()


def test_a_shift_on_the_table_keeps_height_and_tilt():
    pose, random = random_poses(7, 5), np.random.default_rng(7)
    shift, center = random.normal(size=(5, 3)), random.normal(size=(5, 3))
    result = shift_on_table(pose, shift, center)
    before = transform_points(pose, center[:, None])[:, 0]
    after = transform_points(result, center[:, None])[:, 0]
    np.testing.assert_allclose(after[:, :2] - before[:, :2], shift[:, :2], atol=1e-12)
    np.testing.assert_allclose(after[:, 2], before[:, 2], atol=1e-12)
    # As if the world had been turned under the object, but for where it is.
    yaw = np.zeros((5, 7))
    yaw[:, 3], yaw[:, 6] = np.cos(shift[:, 2] / 2), np.sin(shift[:, 2] / 2)
    np.testing.assert_allclose(result[:, 3:], compose(yaw, pose)[:, 3:], atol=1e-12)
    np.testing.assert_allclose(shift_on_table(pose, shift)[:, 2], pose[:, 2], atol=1e-12)
