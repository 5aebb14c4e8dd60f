"""Sensors: wrong by the bias always, by the jitter anew each time, late, and with gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand, scene
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import invert, quaternion_multiply, rotate, transform_points
from fungrasp.sim2real import (
    NOMINAL,
    WIDE,
    EpisodeSample,
    MeasurementError,
    Randomization,
    draw,
    draw_each,
)
from fungrasp.task import Action, LiftEnvironment, Observation
from fungrasp.task.hand_clearance import HandClearance

BOTH = np.arange(2)


def begun(
    r: Randomization,
    rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
    sample: EpisodeSample | None = None,
) -> LiftEnvironment:
    environment = LiftEnvironment(scene(), 2, r, rng=rng, threads=1)
    environment.settle(grasps_and_objects()[0], sample or draw_each(r, 0, BOTH, len(hand().joint_names)))
    return environment


def still(environment: LiftEnvironment) -> Action:
    setpoints = environment.task.setpoints
    return Action(setpoints.wrist.pose.copy(), setpoints.fingers.copy(), np.zeros(2, bool))


def wander(environment: LiftEnvironment, steps: int) -> tuple[list[np.ndarray], list[Observation]]:
    """Objects that are carried along, at another place at every setpoint.

    Returns:
        Their poses at the beginning and at every setpoint, and what is seen after every control step.
    """
    engine = environment.engine
    poses, seen = [engine.object_pose], []

    def carry() -> None:
        poses.append(engine.object_pose)

    for _ in range(steps):
        engine.push_object(np.array([[0.4, 0.3, 0.0], [0.1, -0.2, 0.0]]))
        environment.step(still(environment), carry)
        seen.append(environment.observe())
    return poses, seen


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rotation vector from orientation a to b in the frame of a [rad]."""
    first, second = (Rotation.from_quat(q, scalar_first=True) for q in (a, b))
    return (first.inv() * second).as_rotvec()


def assert_same(a: Observation, b: Observation, rows: np.ndarray | slice = slice(None)) -> None:
    for name, value in a.arrays().items():
        np.testing.assert_array_equal(value[rows], b.arrays()[name][rows], err_msg=name)


def test_without_errors_what_is_seen_is_what_is():
    environment = begun(NOMINAL)
    environment.step(still(environment))
    seen, engine, task = environment.observe(), environment.engine, environment.task
    np.testing.assert_array_equal(seen.joint_positions, hand().independent(engine.joint_positions))
    np.testing.assert_array_equal(seen.palm_pose, engine.palm_pose)
    np.testing.assert_array_equal(seen.object_pose, engine.object_pose)
    np.testing.assert_array_equal(seen.joint_setpoints, task.setpoints.fingers)
    np.testing.assert_array_equal(seen.palm_setpoint, task.setpoints.wrist.pose)
    np.testing.assert_array_equal(seen.object_pose_age, 0.0)
    np.testing.assert_allclose(seen.time, 0.1)
    np.testing.assert_array_equal(seen.time_since_lift, -1.0)
    assert_same(environment.observe(), seen)
    environment.step(replace(still(environment), lift=np.array([True, False])))
    np.testing.assert_allclose(environment.observe().time_since_lift, [0.1, -1.0])


def test_what_is_seen_does_not_change_afterwards():
    environment = begun(WIDE)
    seen = environment.observe()
    kept = {name: value.copy() for name, value in seen.arrays().items()}
    for _ in range(3):
        environment.step(still(environment))
        environment.observe()
    for name, value in kept.items():
        np.testing.assert_array_equal(seen.arrays()[name], value, err_msg=name)


def test_joints_are_off_by_the_bias_and_a_fresh_jitter():
    environment = begun(Randomization(joint_error=MeasurementError(0.1, 0.01)))
    truth = hand().independent(environment.engine.joint_positions)
    error = np.stack([environment.observe().joint_positions for _ in range(400)]) - truth
    bias = hand().independent(environment.sample.joint_bias)
    assert np.abs(bias).max() > 0.05
    np.testing.assert_allclose(error.mean(axis=0), bias, atol=0.003)
    np.testing.assert_allclose(error.std(axis=0), 0.01, rtol=0.2)


@pytest.mark.parametrize("what", ["palm", "object"])
def test_poses_are_off_by_the_bias_and_a_fresh_jitter(what):
    errors = {
        f"{what}_position_error": MeasurementError(0.1, 0.01),
        f"{what}_rotation_error": MeasurementError(0.05, 0.02),
    }
    environment = begun(Randomization(**errors))
    true = getattr(environment.engine, f"{what}_pose")
    seen = [getattr(environment.observe(), f"{what}_pose") for _ in range(400)]
    center = np.zeros((2, 3))
    if what == "object":  # It turns about its center of mass.
        center = rotate(invert(true)[:, 3:], environment.engine.center_of_mass - true[:, :3])
    at = [transform_points(pose, center[:, None])[:, 0] for pose in seen]
    moved = np.stack(at) - transform_points(true, center[:, None])[:, 0]
    turn = np.stack([turned(true[:, 3:], pose[:, 3:]) for pose in seen])
    bias = getattr(environment.sample, f"{what}_bias")
    assert np.abs(bias[:, :3]).max() > 0.03
    np.testing.assert_allclose(moved.mean(axis=0), bias[:, :3], atol=0.003)
    np.testing.assert_allclose(turn.mean(axis=0), bias[:, 3:], atol=0.006)
    np.testing.assert_allclose(moved.std(axis=0), 0.01, rtol=0.2)
    np.testing.assert_allclose(turn.std(axis=0), 0.02, rtol=0.2)


@pytest.mark.parametrize("late", [1, 5])
def test_a_late_tracker_shows_where_the_object_was(late):
    delay = 0.02 * late
    environment = begun(Randomization(tracker_delay=(delay, delay)))
    first = environment.observe()
    np.testing.assert_array_equal(first.object_pose, environment.engine.object_pose)
    np.testing.assert_array_equal(first.object_pose_age, 0.0)
    poses, seen = wander(environment, 6)
    assert np.abs(poses[-1] - poses[-6])[:, :2].max() > 1e-3, "the objects move"
    for step, observation in enumerate(seen[1:], start=2):
        np.testing.assert_allclose(observation.object_pose_age, delay)
        np.testing.assert_array_equal(observation.object_pose, poses[5 * step - late])
    # What is younger than the delay is shown as it is, and said to be younger.
    age = seen[0].object_pose_age
    assert (age <= delay + 1e-9).all()
    np.testing.assert_array_equal(seen[0].object_pose, poses[5 - round(age[0] / 0.02)])


def test_each_tracker_is_as_late_as_drawn():
    r = Randomization(tracker_delay=(0.0, 0.1))
    sample = replace(draw(r, 2, 16, np.random.default_rng(0)), tracker_delay=np.array([0.0, 0.08]))
    environment = begun(r, sample=sample)
    poses, seen = wander(environment, 4)
    np.testing.assert_allclose(seen[-1].object_pose_age, [0.0, 0.08])
    np.testing.assert_array_equal(seen[-1].object_pose[0], poses[-1][0])
    np.testing.assert_array_equal(seen[-1].object_pose[1], poses[-5][1])


def test_a_missing_frame_repeats_the_last_pose_and_ages_it():
    r = Randomization(tracker_dropout=0.5)
    environment = begun(r)
    first = environment.observe()
    np.testing.assert_array_equal(first.object_pose_age, 0.0)
    poses, seen = wander(environment, 60)
    ages = np.array([observation.object_pose_age for observation in seen])
    missing = ages > 0
    assert 0.35 < missing.mean() < 0.65 and ages.max() > 0.25
    for step, observation in enumerate(seen, start=1):
        back = np.rint(observation.object_pose_age / 0.1).astype(int)
        np.testing.assert_allclose(observation.object_pose_age, 0.1 * back, atol=1e-9)
        for world in range(2):
            shown = poses[5 * (step - back[world])][world]
            np.testing.assert_array_equal(observation.object_pose[world], shown)


def test_looking_twice_ages_nothing():
    """Training looks again where episodes begin anew."""
    environment = begun(Randomization(tracker_dropout=1.0))
    first = environment.observe()
    for step in range(1, 4):
        environment.step(still(environment))
        for _ in range(3):
            seen = environment.observe()
            np.testing.assert_allclose(seen.object_pose_age, 0.1 * step)
            np.testing.assert_array_equal(seen.object_pose, first.object_pose)


def test_an_episode_that_begins_has_no_past():
    """The tracker neither shows where the object was before, nor repeats what it has not seen, nor shows it
    without its bias."""
    r = Randomization(
        tracker_delay=(0.1, 0.1),
        tracker_dropout=1.0,
        object_position_error=MeasurementError(offset=0.01),
    )
    environment = begun(r)
    environment.observe()
    wander(environment, 3)
    before = environment.observe()
    task = environment.task
    moved = task.settled_pose[1:] + np.array([0.2, 0, 0, 0, 0, 0, 0])
    task.begin(
        np.array([1]),
        moved,
        environment.engine.wrist_frame[1:],
        task.setpoints.wrist.pose[1:].copy(),
        task.setpoints.fingers[1:].copy(),
        task.target_contacts[1:],
    )
    environment.sensors.begin(np.array([1]))
    seen = environment.observe()
    np.testing.assert_array_equal(seen.object_pose[0], before.object_pose[0])
    off = np.linalg.norm((seen.object_pose[1] - moved[0])[:3])
    assert off == pytest.approx(0.01, rel=1e-6)
    environment.step(still(environment))
    np.testing.assert_array_equal(environment.observe().object_pose[1], seen.object_pose[1])


def test_a_world_with_its_own_generator_does_not_depend_on_the_others():
    r = replace(WIDE, tracker_dropout=0.3)

    def seen(rows: list[int]) -> list[Observation]:
        """Of worlds that hold the same can and differ in their numbers alone."""
        grasps, _ = grasps_and_objects()
        environment = LiftEnvironment(
            scene(), 2, r, rng=[np.random.default_rng([5, row]) for row in rows], threads=1
        )
        environment.settle(grasps.select(np.zeros(2, int)), draw_each(r, 5, rows, len(hand().joint_names)))
        result = []
        for _ in range(8):
            environment.step(still(environment))
            result.append(environment.observe())
        return result

    for one, other in zip(seen([3, 4]), seen([9, 4]), strict=True):
        assert_same(one, other, np.array([1]))
        assert not np.array_equal(one.joint_positions[0], other.joint_positions[0])
    for one, other in zip(seen([3, 4]), seen([4, 3]), strict=True):
        assert_same(one.select(np.array([1, 0])), other)


def test_a_sample_may_be_wrong_by_more_than_is_drawn():
    """As in rollouts, which draw from a belief's covariance: the bias counts though no error is drawn."""
    sample = draw_each(NOMINAL, 0, BOTH, len(hand().joint_names))
    sample = replace(sample, object_bias=np.array([[0.01, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0.1]]))
    environment = begun(NOMINAL, sample=sample)
    off = environment.observe().object_pose - environment.engine.object_pose
    np.testing.assert_allclose(off[0], [0.01, 0, 0, 0, 0, 0, 0], atol=1e-9)
    assert np.abs(off[1, 3:]).max() > 0.01


def test_a_filtered_tracker_closes_a_share_of_the_gap_in_each_control_period():
    environment = begun(Randomization(tracker_time_constant=0.2))
    engine = environment.engine
    first = environment.observe().object_pose
    np.testing.assert_allclose(first, engine.object_pose, atol=1e-12)
    moved = first.copy()
    moved[:, 0] += 0.1
    moved[:, 3:] = quaternion_multiply(first[:, 3:], np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)]))
    engine.set_state(object_pose=moved)
    share = 1.0 - np.exp(-0.1 / 0.2)
    for left in (1.0 - share, (1.0 - share) ** 2):
        seen = environment.observe().object_pose
        np.testing.assert_allclose(moved[:, 0] - seen[:, 0], 0.1 * left, atol=1e-9)
        np.testing.assert_allclose(
            np.linalg.norm(turned(seen[:, 3:], moved[:, 3:]), axis=1), 0.4 * left, atol=1e-6
        )
    environment.sensors.begin(np.array([1]))
    seen = environment.observe().object_pose
    np.testing.assert_allclose(seen[1], moved[1], atol=1e-12)
    assert abs(seen[0, 0] - moved[0, 0]) > 0.01


def test_a_tracker_loses_the_object_while_the_hand_is_at_it(monkeypatch):
    near = [0.01]
    monkeypatch.setattr(
        HandClearance, "measure", lambda self, rows, *_: (np.full(len(rows), near[0]), np.zeros(len(rows)))
    )
    r = Randomization(tracker_freeze=0.5)
    drawn = replace(draw(r, 2, 16, np.random.default_rng(0)), tracker_freezes=np.array([True, False]))
    environment = begun(r, sample=drawn)
    before = environment.observe()
    touched = np.zeros((2, len(hand().links)), dtype=bool)
    engine = environment.engine
    _, (seen, *_) = wander(environment, 1)
    np.testing.assert_array_equal(seen.object_pose, engine.object_pose)
    touched[:, 3] = True
    type(engine).link_contacts, real = property(lambda self: touched), type(engine).link_contacts
    try:
        _, (first,) = wander(environment, 1)
        touched[:] = False
        _, (later,) = wander(environment, 1)
        near[0] = 0.1
        _, (again,) = wander(environment, 1)
    finally:
        type(engine).link_contacts = real
    for moment, steps in ((first, 1), (later, 2)):
        np.testing.assert_array_equal(moment.object_pose[0], seen.object_pose[0])
        np.testing.assert_allclose(moment.object_pose_age, [0.1 * steps, 0.0])
        assert np.abs(moment.object_pose[1] - before.object_pose[1]).max() > 0
    # With the hand away it is seen again.
    np.testing.assert_array_equal(again.object_pose, engine.object_pose)
    np.testing.assert_allclose(again.object_pose_age, 0.0, atol=1e-9)
    assert np.abs(again.object_pose[0] - seen.object_pose[0]).max() > 0
