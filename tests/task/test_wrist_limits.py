"""Set points keep the wrist's limits, whatever the goals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fungrasp.task import LiftProtocol
from fungrasp.task.setpoints import WristSetpoint

DT = 0.02


def poses(seed: int, count: int, worlds: int, reach: float) -> np.ndarray:
    random = np.random.default_rng(seed)
    result = np.empty((count, worlds, 7))
    result[..., :3] = random.uniform(-reach, reach, (count, worlds, 3))
    turns = Rotation.random(count * worlds, rng=random).as_quat(scalar_first=True)
    result[..., 3:] = turns.reshape(count, worlds, 4)
    return result


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between orientations wxyz [rad]."""
    return 2 * np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.005, 1.0), period=st.integers(1, 60))
def test_speed_acceleration_and_rotation_stay_within_limits(seed, reach, period):
    p = LiftProtocol()
    goals = poses(seed, 8, 4, reach)
    point = WristSetpoint(goals[0], p)
    path, velocities = [point.pose.copy()], [point.velocity.copy()]
    for goal in goals[1:]:
        for _ in range(period):
            point.advance(goal, DT)
            path.append(point.pose.copy())
            velocities.append(point.velocity.copy())
    moved, velocity = np.array(path), np.array(velocities)
    np.testing.assert_allclose(np.diff(moved[..., :3], axis=0), DT * velocity[1:], atol=1e-12)
    assert np.linalg.norm(velocity, axis=-1).max() <= p.wrist_speed + 1e-9
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max() <= DT * p.wrist_acceleration + 1e-9
    assert turned(moved[1:, :, 3:], moved[:-1, :, 3:]).max() <= DT * p.wrist_rotation_speed + 1e-6
    np.testing.assert_allclose(np.linalg.norm(moved[..., 3:], axis=-1), 1.0, atol=1e-9)


def test_a_turn_with_a_limit_of_acceleration_begins_and_ends_with_a_ramp():
    p = LiftProtocol(wrist_rotation_acceleration=2.0)
    start, goal = poses(3, 2, 4, 0.1)
    point, path = WristSetpoint(start, p), [start]
    for _ in range(50):
        path.extend(point.advance(goal, DT, 5)[0])
    places = [Rotation.from_quat(pose[:, 3:], scalar_first=True) for pose in path]
    rates = np.array([(b * a.inv()).as_rotvec() for a, b in pairwise(places)]) / DT
    assert np.linalg.norm(rates, axis=-1).max() <= p.wrist_rotation_speed + 1e-6
    changes = np.diff(rates, axis=0, prepend=0.0)
    assert np.linalg.norm(changes, axis=-1).max() <= 2.0 * DT + 1e-3
    assert turned(path[-1][:, 3:], goal[:, 3:]).max() < 1e-3 and np.abs(point.turning).max() < 1e-3


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.005, 0.5))
def test_a_goal_is_reached_without_going_past_it(seed, reach):
    p = LiftProtocol()
    start, goal = poses(seed, 2, 5, reach)
    point = WristSetpoint(start, p)
    away = np.linalg.norm(goal[:, :3] - start[:, :3], axis=1)
    line = (goal[:, :3] - start[:, :3]) / away[:, None]
    longest = max(away.max() / p.wrist_speed + 2 * p.wrist_speed / p.wrist_acceleration, np.pi) + 1.0
    for _ in range(int(longest / DT)):
        point.advance(goal, DT)
        assert (np.sum((point.pose[:, :3] - goal[:, :3]) * line, axis=1) < 1e-3).all()
    np.testing.assert_allclose(point.pose[:, :3], goal[:, :3], atol=1e-4)
    assert turned(point.pose[:, 3:], goal[:, 3:]).max() < 1e-3


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.0, 1.0), period=st.integers(1, 30))
def test_several_steps_at_once_are_as_one_after_the_other(seed, reach, period):
    goals = poses(seed, 6, 4, reach)
    goals[3] = goals[2]
    at_once, one_by_one = WristSetpoint(goals[0], LiftProtocol()), WristSetpoint(goals[0], LiftProtocol())
    for goal in goals[1:]:
        pose, velocity = at_once.advance(goal, DT, period)
        for step in range(period):
            one_by_one.advance(goal, DT)
            np.testing.assert_allclose(pose[step], one_by_one.pose, atol=1e-9)
            np.testing.assert_allclose(velocity[step], one_by_one.velocity, atol=1e-9)
        np.testing.assert_array_equal(at_once.pose, pose[-1])


def test_the_lift_takes_as_long_as_the_acceleration_allows():
    """0.15 m from rest to rest at 0.3 m/s2: half of it up to 0.21 m/s, 2 sqrt(0.15 / 0.3) = 1.41 s."""
    start = np.array([[0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]])
    goal = start + np.array([[0, 0, 0.15, 0, 0, 0, 0]])
    point = WristSetpoint(start, LiftProtocol())
    times = []
    for step in range(100):
        point.advance(goal, DT)
        if abs(point.pose[0, 2] - goal[0, 2]) < 2e-3:
            times.append((step + 1) * DT)
    assert 1.2 < times[0] < 1.7
