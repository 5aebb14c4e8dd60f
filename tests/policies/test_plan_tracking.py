"""References followed in worlds: where the object goes until the fingers close, and not after."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand, motion, references, start, tracker

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.policies import ReferenceController, play
from fungrasp.policies.plan_tracking import Tracker, link_directions
from fungrasp.policies.residual_action import ResidualSettings, apply
from fungrasp.task import LiftTask, Protocol
from fungrasp.task.observation import Readings, flatten, observe

PERIOD = Protocol().control_period


def nothing(at_work: Tracker) -> np.ndarray:
    return np.zeros((2, at_work.size))


def push(task: LiftTask, shift: tuple[float, float, float]) -> np.ndarray:
    """The objects' poses after moving them."""
    pose = task.worlds.object_pose
    pose[:, :3] += shift
    task.worlds.object_pose = pose
    task.worlds.forward()
    return pose


def test_the_reference_goes_where_the_object_goes_until_the_fingers_close():
    task, plan = start(), motion()
    at_work = tracker(task)
    for step, shift in ((np.zeros(2, int), (0.02, 0, 0)), (plan.closing - 1, (0, 0.03, 0))):
        task.time[:] = PERIOD * step
        pose = push(task, shift)
        at_work.advance()
        goal, fingers = plan.at(step)
        action = at_work.act(nothing(at_work))
        np.testing.assert_allclose(action.wrist_pose, compose(pose, goal), atol=1e-9)
        np.testing.assert_array_equal(action.finger_targets, fingers)
        np.testing.assert_allclose(at_work.view().wanted.palm_goal, compose(pose, goal), atol=1e-9)
        assert not action.lift.any()
    for step in (plan.closing, plan.lift):
        task.time[:] = PERIOD * step
        push(task, (0.05, 0.05, 0))
        at_work.advance()
        action = at_work.act(nothing(at_work))
        np.testing.assert_allclose(action.wrist_pose, compose(pose, plan.at(step)[0]), atol=1e-9)
        np.testing.assert_array_equal(action.lift, step >= plan.lift)


def test_what_is_wanted_tells_the_time_to_closing_and_the_lift():
    task, plan = start(), motion()
    at_work = tracker(task)
    wanted = at_work.view().wanted
    np.testing.assert_allclose(wanted.since_closing, -PERIOD * plan.closing)
    np.testing.assert_array_equal(wanted.since_lift, -1.0)
    task.time[:] = PERIOD * (plan.lift + 3)
    task.lift_time[0] = PERIOD * plan.lift[0]
    at_work.advance()
    wanted = at_work.view().wanted
    np.testing.assert_allclose(wanted.since_closing, PERIOD * (plan.lift + 3 - plan.closing))
    np.testing.assert_allclose(wanted.since_lift, [0.3, -1.0])
    goal = compose(task.settled_pose, plan.at(plan.lift + 3)[0])
    np.testing.assert_allclose(wanted.palm_goal[:, 2] - goal[:, 2], [0.15, 0.0], atol=1e-9)


def test_without_actions_trials_end_as_the_reference_controllers():
    short = Protocol(hold_time=0.5)
    task = start(short)
    expected = play(task, ReferenceController(task, grasps_and_objects()[1]))
    assert expected.success.any()
    other = start(short)
    at_work = tracker(other)
    other.step(at_work.act(nothing(at_work)))
    while not other.done.all():
        at_work.advance()
        other.step(at_work.act(nothing(at_work)))
    trials = other.trials()
    np.testing.assert_array_equal(trials.success, expected.success)
    np.testing.assert_array_equal(trials.reason, expected.reason)
    np.testing.assert_array_equal(other.lift_time, task.lift_time)
    np.testing.assert_allclose(trials.lifted_height_m, expected.lifted_height_m, atol=3e-3)


def test_actions_are_smoothed_residuals_of_the_reference():
    settings = ResidualSettings(smoothing=0.5)
    at_work, plan = tracker(settings=settings), motion()
    action = np.random.default_rng(0).uniform(-1, 1, (2, at_work.size))
    asked = at_work.act(action)
    goal, fingers = plan.at(np.zeros(2, int))
    settled = references().settled_pose
    expected = apply(compose(settled, goal), fingers, 0.5 * action, settings)
    np.testing.assert_allclose(asked.wrist_pose, expected[0], atol=1e-12)
    np.testing.assert_allclose(asked.finger_targets, expected[1], atol=1e-12)
    at_work.act(action)
    np.testing.assert_allclose(at_work.view().action, 0.75 * action)


def test_beginning_anew_in_some_worlds_leaves_the_others():
    task = start()
    at_work = tracker(task)
    for _ in range(2):
        at_work.act(np.ones((2, at_work.size)))
        push(task, (0.01, 0, 0))
        task.time += PERIOD
        at_work.advance()
    before = at_work.view()
    kept = {field.name: getattr(before.now, field.name)[0].copy() for field in fields(Readings)}
    goal = before.wanted.palm_goal[0].copy()
    task.time[1] = 0.0
    at_work.begin(np.array([1]), np.array([1]))
    after = at_work.view()
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(after.now, name)[0], value, err_msg=name)
    np.testing.assert_array_equal(after.wanted.palm_goal[0], goal)
    assert np.all(after.action[0] == 0.75) and not after.action[1].any()
    np.testing.assert_array_equal(after.before.object_pose[1], after.now.object_pose[1])
    assert (after.before.object_pose[0] != after.now.object_pose[0]).any()
    first = compose(after.now.object_pose, motion().at(np.zeros(2, int))[0])
    np.testing.assert_allclose(after.wanted.palm_goal[1], first[1], atol=1e-9)


def test_a_world_may_follow_any_reference():
    """Both worlds the ball's, though one of them holds the can."""
    at_work = tracker()
    at_work.begin(np.array([0]), np.array([1]))
    wanted = at_work.view().wanted
    for name in ("keypoints", "contacts", "mass", "palm_in_object"):
        values = getattr(wanted, name)
        np.testing.assert_array_equal(values[0], values[1])
    objects = grasps_and_objects()[1]
    np.testing.assert_array_equal(wanted.size, [objects["can"].size, objects["tennis_ball"].size])


class Wrong:
    """Sensors that are off by constants."""

    def joints(self, joints: np.ndarray) -> np.ndarray:
        return joints + 0.1

    def palm(self, pose: np.ndarray) -> np.ndarray:
        return pose + np.array([0.01, 0, 0, 0, 0, 0, 0])

    def object(self, pose: np.ndarray) -> np.ndarray:
        return pose + np.array([0, 0.02, 0, 0, 0, 0, 0])


def test_noise_is_in_what_is_read_and_in_what_is_followed():
    right, wrong = tracker(), tracker(noise=Wrong())
    a, b = right.view().now, wrong.view().now
    np.testing.assert_allclose(b.joints - a.joints, 0.1)
    np.testing.assert_allclose((b.palm_pose - a.palm_pose)[:, :3], [[0.01, 0, 0]] * 2, atol=1e-12)
    np.testing.assert_allclose((b.object_pose - a.object_pose)[:, :3], [[0, 0.02, 0]] * 2, atol=1e-12)
    np.testing.assert_array_equal(a.servo_targets, b.servo_targets)
    for at_work in (right, wrong):
        at_work.advance()
    goals = [at_work.act(nothing(at_work)).wrist_pose for at_work in (right, wrong)]
    np.testing.assert_allclose((goals[1] - goals[0])[:, :3], [[0, 0.02, 0]] * 2, atol=1e-9)


def test_readings_are_of_the_worlds():
    """The ball is put around a fingertip."""
    task = start()
    at_work = tracker(task)
    tip = hand().keypoint_names.index(hand().fingers["index"].tip)
    now = at_work.view().now
    pose = task.worlds.object_pose
    pose[1, :3] = transform_points(now.palm_pose, now.keypoints)[1, tip]
    task.worlds.object_pose = pose
    task.worlds.forward()
    at_work.advance()
    now = at_work.view().now
    np.testing.assert_array_equal(now.palm_pose, task.worlds.palm_pose)
    np.testing.assert_allclose(now.object_pose, task.worlds.object_pose, atol=1e-9)
    in_world = transform_points(now.palm_pose, now.keypoints)
    bodies = {task.scene.model.body(i).name: i for i in range(task.scene.model.nbody)}
    known = [i for i, name in enumerate(hand().keypoint_names) if f"hand/{name}" in bodies]
    assert len(known) > 10
    ids = [bodies[f"hand/{hand().keypoint_names[i]}"] for i in known]
    np.testing.assert_allclose(in_world[:, known], task.worlds.batch.bind("xpos")[:, ids], atol=1e-6)
    objects = grasps_and_objects()[1]
    ball = objects["tennis_ball"]
    center = transform_points(now.object_pose[1:], ball.center_of_mass[None, None])[0]
    distance = np.linalg.norm(in_world[1] - center, axis=1) - ball.size.max() / 2
    near = distance < 0.02
    assert near.sum() > 1 and now.surface_distance[1, tip] < -0.02
    np.testing.assert_allclose(now.surface_distance[1, near], distance[near], atol=4e-3)
    parts = observe(now, now, at_work.view().wanted, np.zeros((2, 22)))
    assert np.isfinite(flatten(parts)).all()


def test_nothing_can_be_seen_before_the_beginning():
    at_work = Tracker(start(), grasps_and_objects()[1], references())
    for call in (at_work.view, at_work.advance):
        with pytest.raises(RuntimeError, match="begin comes before"):
            call()


def test_directions_along_the_links():
    """The thumb's key points in a row, a centimetre apart; all others at the origin."""
    names = list(hand().keypoint_names)
    keypoints = np.zeros((1, len(names), 3))
    thumb = list(hand().fingers).index("thumb")
    links = [len(finger.links) for finger in hand().fingers.values()]
    first = 1 + sum(number + 1 for number in links[:thumb])
    keypoints[0, first : first + links[thumb] + 1, 0] = 0.01 * np.arange(links[thumb] + 1)
    directions = link_directions(hand(), keypoints)
    assert directions.shape == (1, len(links), 3, 3)
    np.testing.assert_allclose(directions[0, thumb, :, 0], 0.01)
    assert not np.delete(directions[0], thumb, axis=0).any()
