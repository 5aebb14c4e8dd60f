"""Whether an attempt has failed, from what is seen of the object in the last second."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, plan

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.task import Observation
from fungrasp.task.attempt_judge import FRAMES, AttemptJudge, TrackedFrames, average_pose


def seen(step: int, rise: np.ndarray, age: float = 0.1, jitter: np.ndarray | None = None) -> Observation:
    """The objects of the two plans this far above where they rest [m], shape [2]."""
    pose = plan().object_pose.copy()
    pose[:, 2] += rise
    pose[:, :3] += 0.0 if jitter is None else jitter
    joints, palm = np.zeros((2, 16)), np.tile([0.0, 0, 0.3, 1, 0, 0, 0], (2, 1))
    return Observation(
        time=np.full(2, 0.1 * step),
        time_since_lift=np.full(2, 0.1 * step - 1.0),
        joint_positions=joints,
        joint_setpoints=joints,
        palm_pose=palm,
        palm_setpoint=palm,
        object_pose=pose,
        object_pose_age=np.full(2, age),
    )


def judge() -> AttemptJudge:
    return AttemptJudge(plan(), grasps_and_objects()[1])


def test_what_is_held_up_is_held_and_what_stayed_behind_is_missed():
    watching, rng = judge(), np.random.default_rng(0)
    for step in range(60):
        # One is lifted, the other falls after it was lifted.
        rise = np.array([0.15, 0.15 if step < 40 else 0.0])
        watching.watch(seen(step, rise, jitter=rng.normal(scale=0.002, size=(2, 3))))
    verdict = watching.verdict()
    assert verdict.seen.all()
    assert verdict.missed.tolist() == [False, True]
    assert verdict.rise.tolist() == pytest.approx([0.15, 0.0], abs=0.002)
    assert verdict.gap.tolist() == pytest.approx([0.15, 0.0], abs=0.002)


def test_an_object_that_is_not_seen_is_taken_to_be_held():
    """The hand covers what it holds; what is left behind is seen."""
    watching = judge()
    for step in range(60):
        watching.watch(seen(step, np.zeros(2), age=0.1 if step < 20 else 0.1 * (step - 18)))
    verdict = watching.verdict()
    assert not verdict.seen.any() and not verdict.missed.any()
    assert np.isnan(verdict.rise).all()
    np.testing.assert_array_equal(verdict.gap, 0.0)


@pytest.mark.parametrize("age", [0.1, 2.0])
def test_what_is_dropped_as_the_hold_ends_is_missed(age):
    """Whether it was seen in the hand or not."""
    watching = judge()
    for step in range(60):
        fallen = step >= 57
        watching.watch(seen(step, np.zeros(2) if fallen else np.full(2, 0.15), 0.1 if fallen else age))
    assert watching.verdict().missed.all()


def test_nothing_is_judged_by_what_was_seen_before_the_lift():
    watching = judge()
    for step in range(10):
        watching.watch(seen(step, np.zeros(2)))
    assert not watching.verdict().seen.any()


def test_a_gap_is_below_the_lowest_point():
    """A tilted object hangs lower than its center of mass tells."""
    watching, half = judge(), np.sqrt(0.5)
    up = plan().object_pose.copy()
    up[:, 2] += 0.2
    tilted = compose(up, np.tile([0.0, 0, 0, half, half, 0, 0], (2, 1)))
    for step in range(20, 40):
        watching.watch(replace(seen(step, np.zeros(2)), object_pose=tilted))
    objects = grasps_and_objects()[1]
    names = plan().object_name.tolist()
    for w, name in enumerate(names):
        around = objects[name].vertices
        lowest = transform_points(tilted[w : w + 1], around[None])[0, :, 2].min()
        resting = transform_points(plan().object_pose[w : w + 1], around[None])[0, :, 2].min()
        assert watching.verdict().gap[w] == pytest.approx(lowest - resting, abs=1e-9)


def test_an_object_that_rolls_is_not_at_rest():
    frames, both = TrackedFrames(2), np.ones(2, dtype=bool)
    for step in range(FRAMES):
        # 2 cm/s against nothing.
        moved = np.array([[0.002 * step, 0, 0], [0, 0, 0]])
        frames.add(seen(step, np.zeros(2), jitter=moved), both)
    assert frames.at_rest.tolist() == [False, True]


def test_a_control_step_counts_once():
    """Where an episode is over, the same one is seen again and again."""
    frames, both = TrackedFrames(2), np.ones(2, dtype=bool)
    for _ in range(FRAMES):
        frames.add(seen(3, np.zeros(2)), both)
    assert not frames.seen().any()


def test_poses_are_averaged_whatever_the_sign_of_their_quaternions():
    pose = np.array([0.1, 0.2, 0.3, 0.6, 0.0, 0.8, 0.0])
    flipped = pose * [1, 1, 1, -1, -1, -1, -1]
    np.testing.assert_allclose(average_pose(np.stack([flipped, pose])), pose)
    assert np.isnan(average_pose(np.empty((0, 7)))).all()
