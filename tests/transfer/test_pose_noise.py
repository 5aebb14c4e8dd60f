"""Measured joints and poses: wrong by the bias always, by the jitter anew each time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.transfer import (
    NONE,
    Randomisation,
    Spread,
    noisy_joints,
    noisy_object,
    noisy_wrist,
    offset_pose,
    sample,
    shift_on_table,
)

JOINTS = 16


def random_poses(seed: int, count: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=random).as_quat(scalar_first=True)
    return np.concatenate([random.normal(size=(count, 3)), turns], axis=1)


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rotation vector from orientation a to b in the frame of a [rad]."""
    first, second = (Rotation.from_quat(q, scalar_first=True) for q in (a, b))
    return (first.inv() * second).as_rotvec()


def test_without_noise_what_is_measured_is_what_is():
    rng = np.random.default_rng(0)
    drawn, pose, angles = sample(NONE, 4, JOINTS, rng), random_poses(0, 4), rng.normal(size=(4, JOINTS))
    np.testing.assert_array_equal(noisy_joints(angles, drawn, NONE, rng), angles)
    np.testing.assert_allclose(noisy_wrist(pose, drawn, NONE, rng), pose, atol=1e-15)
    center = rng.normal(size=(4, 3))
    np.testing.assert_allclose(noisy_object(pose, drawn, NONE, rng, center), pose, atol=1e-15)


def test_joint_noise_is_the_bias_and_a_fresh_jitter():
    r = replace(NONE, joint_noise=Spread(0.1, 0.01))
    rng = np.random.default_rng(1)
    drawn, angles = sample(r, 3, JOINTS, rng), rng.normal(size=(3, JOINTS))
    error = np.stack([noisy_joints(angles, drawn, r, rng) for _ in range(400)]) - angles
    np.testing.assert_allclose(error.mean(axis=0), drawn.joint_bias, atol=0.003)
    np.testing.assert_allclose(error.std(axis=0), 0.01, rtol=0.2)


def test_pose_noise_is_the_bias_and_a_fresh_jitter():
    wrist = replace(NONE, wrist_position_noise=Spread(0.1, 0.01), wrist_rotation_noise=Spread(0.05, 0.02))
    thing = replace(NONE, object_position_noise=Spread(0.1, 0.01), object_rotation_noise=Spread(0.05, 0.02))
    for r, measure, bias in ((wrist, noisy_wrist, "wrist_bias"), (thing, noisy_object, "object_bias")):
        rng = np.random.default_rng(2)
        drawn, pose = sample(r, 3, JOINTS, rng), random_poses(3, 3)
        seen = [measure(pose, drawn, r, rng) for _ in range(400)]
        moved = np.stack([s[:, :3] for s in seen]) - pose[:, :3]
        turn = np.stack([turned(pose[:, 3:], s[:, 3:]) for s in seen])
        np.testing.assert_allclose(moved.mean(axis=0), getattr(drawn, bias)[:, :3], atol=0.003)
        np.testing.assert_allclose(turn.mean(axis=0), getattr(drawn, bias)[:, 3:], atol=0.006)
        np.testing.assert_allclose(moved.std(axis=0), 0.01, rtol=0.2)
        np.testing.assert_allclose(turn.std(axis=0), 0.02, rtol=0.2)


def test_the_same_generator_state_gives_the_same_measurement():
    r, pose, angles = Randomisation(), random_poses(0, 2), np.zeros((2, JOINTS))

    def measured(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        drawn = sample(r, 2, JOINTS, rng)
        parts = [noisy_joints(angles, drawn, r, rng), noisy_wrist(pose, drawn, r, rng)]
        return np.concatenate([*parts, noisy_object(pose, drawn, r, rng)], axis=1)

    np.testing.assert_array_equal(measured(3), measured(3))
    assert not np.array_equal(measured(3), measured(4))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_an_offset_turns_about_the_centre_and_moves_it_by_its_first_half(seed: int):
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
