"""Plans followed: where the object is seen until the fingers close, and not after."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand, plan, start, tracker

from fungrasp.geometry.poses import (
    compose,
    interpolate_pose,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    transform_points,
)
from fungrasp.policies.plan_tracking import ANCHOR_SHARE, PlanTracker, link_directions_of
from fungrasp.policies.residual_action import ResidualSettings, add_residual
from fungrasp.policies.slip_response import HARDEST, HIGHEST
from fungrasp.task import LiftProtocol, Observation
from fungrasp.task.features import MeasuredState, flatten

PERIOD = LiftProtocol().control_period


def nothing(at_work: PlanTracker) -> np.ndarray:
    return np.zeros((2, at_work.size))


def later(seen: Observation, step: np.ndarray, shift: tuple[float, float, float]) -> Observation:
    """What is seen at another step, the objects moved."""
    pose = seen.object_pose.copy()
    pose[:, :3] += shift
    return replace(seen, time=PERIOD * step, object_pose=pose)


def test_the_plan_goes_where_the_object_goes_until_the_fingers_close():
    seen, p = start().observe(), plan()
    at_work = tracker()
    pose = seen.object_pose.copy()
    for step, shift in ((np.zeros(2, int), (0.02, 0, 0)), (p.closing_step - 1, (0, 0.03, 0))):
        seen = later(seen, step, shift)
        at_work.update(seen)
        pose[:, :3] += ANCHOR_SHARE * (seen.object_pose - pose)[:, :3]
        goal, fingers = p.at(step)
        action = at_work.act(nothing(at_work))
        np.testing.assert_allclose(action.palm_goal_world, compose(pose, goal), atol=1e-9)
        np.testing.assert_array_equal(action.finger_targets, fingers)
        wanted = at_work.state().target.palm_goal_world
        np.testing.assert_allclose(wanted, compose(pose, goal), atol=1e-9)
        assert not action.lift.any()
    for step in (p.closing_step, p.lift_step):
        at_work.update(later(seen, step, (0.05, 0.05, 0)))
        action = at_work.act(nothing(at_work))
        np.testing.assert_allclose(action.palm_goal_world, compose(pose, p.at(step)[0]), atol=1e-9)
        np.testing.assert_array_equal(action.lift, step >= p.lift_step)


def test_the_plan_turns_with_the_object_about_the_vertical_alone():
    """What has rolled is grasped from where the plan came, about its center of mass as it is seen."""
    seen, p, objects = start().observe(), plan(), grasps_and_objects()[1]
    center = np.array([[objects[name].center_of_mass] for name in p.object_name.tolist()])
    about = {"vertical": np.array([0.0, 0.0, 0.5]), "horizontal": np.array([0.6, 0.0, 0.0])}
    for axis, turn in about.items():
        pose = seen.object_pose.copy()
        pose[:, 3:] = quaternion_multiply(quaternion_from_rotation_vector(np.array([turn])), pose[:, 3:])
        at_work = tracker()
        for _ in range(60):
            at_work.update(replace(seen, object_pose=pose))
        goal, wanted = p.at(np.zeros(2, int))[0], pose
        if axis == "horizontal":
            moved = transform_points(pose, center) - transform_points(p.object_pose, center)
            wanted = np.concatenate([p.object_pose[:, :3] + moved[:, 0], p.object_pose[:, 3:]], axis=1)
        action = at_work.act(nothing(at_work))
        np.testing.assert_allclose(action.palm_goal_world, compose(wanted, goal), atol=1e-4)


def test_an_object_that_sinks_is_pressed_harder_and_lifted_higher():
    seen, p = start().observe(), plan()
    at_work = tracker()
    for step in range(20):
        up = 0.01 * step * np.array([0.0, 0.0, 1.0])
        palm, obj = seen.palm_pose.copy(), seen.object_pose.copy()
        palm[:, :3] += up
        obj[0, :3] += up
        obj[1, :3] += 0.5 * up
        time = PERIOD * (p.lift_step + step)
        lifting = replace(
            seen, time=time, time_since_lift=np.full(2, PERIOD * step), palm_pose=palm, object_pose=obj
        )
        at_work.update(lifting)
    goal, fingers = p.at(p.lift_step + 19)
    action = at_work.act(nothing(at_work))
    raised = (action.palm_goal_world - compose(at_work.state().target.settled_pose, goal))[:, 2]
    assert abs(raised[0]) < 2e-3 and 0.05 < raised[1] <= HIGHEST + 1e-3
    np.testing.assert_allclose(action.finger_targets[0], fingers[0])
    np.testing.assert_allclose(
        (action.finger_targets - p.grasp_joints)[1], HARDEST * (fingers - p.grasp_joints)[1], atol=1e-9
    )


def test_jitter_of_the_tracker_moves_the_plan_by_a_third_of_it():
    random, anchor = np.random.default_rng(0), np.tile([0.4, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0], (1000, 1))
    truth = anchor.copy()
    for _ in range(30):
        jitter = np.concatenate([random.normal(0, 0.002, (1000, 3)), truth[:, 3:]], axis=1)
        jitter[:, :2] += truth[:, :2]
        anchor = interpolate_pose(anchor, jitter, np.full((1000, 1), ANCHOR_SHARE))
    np.testing.assert_allclose((anchor - truth)[:, :3].std(), 0.002 / 3, rtol=0.05)


def test_poses_are_moved_a_share_of_the_way():
    quarter = np.sqrt(0.5)
    goal = np.array([[0.1, 0.0, 0.0, quarter, 0.0, 0.0, quarter]])
    half = interpolate_pose(np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]), goal, np.array([[0.5]]))
    turn = np.deg2rad(45) / 2
    np.testing.assert_allclose(half, [[0.05, 0, 0, np.cos(turn), 0, 0, np.sin(turn)]], atol=1e-12)


def test_the_target_tells_the_time_to_closing_and_the_lift():
    seen, p = start().observe(), plan()
    at_work = tracker()
    target = at_work.state().target
    np.testing.assert_allclose(target.since_closing, -PERIOD * p.closing_step)
    np.testing.assert_array_equal(target.since_lift, -1.0)
    after = replace(seen, time=PERIOD * (p.lift_step + 3), time_since_lift=np.array([0.3, -1.0]))
    at_work.update(after)
    target = at_work.state().target
    np.testing.assert_allclose(target.since_closing, PERIOD * (p.lift_step + 3 - p.closing_step))
    np.testing.assert_allclose(target.since_lift, [0.3, -1.0])
    goal = compose(seen.object_pose, p.at(p.lift_step + 3)[0])
    np.testing.assert_allclose(target.palm_goal_world[:, 2] - goal[:, 2], [0.15, 0.0], atol=1e-9)


def test_guided_actions_change_the_grasps_wrist_on_the_tracked_object_and_the_measured_joints():
    settings = ResidualSettings("guided", smoothing=0.0)
    seen, at_work, p = start().observe(), tracker(settings=settings), plan()
    target = at_work.state().target
    np.testing.assert_allclose(
        target.palm_goal_world, compose(seen.object_pose, p.grasp_palm_pose), atol=1e-9
    )
    np.testing.assert_allclose(target.servo_targets, p.grasp_joints)
    action = np.random.default_rng(0).uniform(-1, 1, (2, at_work.size))
    assert not at_work.act(action).lift.any()
    elsewhere = replace(
        seen,
        time=p.lift_step * p.control_period,
        palm_setpoint=seen.palm_setpoint + np.array([0, 0.02, 0, 0, 0, 0, 0]),
        joint_positions=seen.joint_positions + 0.1,
    )
    at_work.update(elsewhere)
    goal = compose(seen.object_pose, p.grasp_palm_pose)
    asked, changed = at_work.act(action), add_residual(goal, elsewhere.joint_positions, action, settings)
    assert asked.lift.all()
    np.testing.assert_allclose(asked.palm_goal_world, changed[0], atol=1e-9)
    np.testing.assert_allclose(asked.finger_targets, changed[1], atol=1e-12)


def test_beginning_anew_in_some_worlds_leaves_the_others():
    seen, at_work = start().observe(), tracker()
    for step in (1, 2):
        at_work.act(np.ones((2, at_work.size)))
        seen = later(seen, np.full(2, step), (0.01, 0, 0))
        at_work.update(seen)
    before = at_work.state()
    kept = {field.name: getattr(before.now, field.name)[0].copy() for field in fields(MeasuredState)}
    goal = before.target.palm_goal_world[0].copy()
    at_work.begin(np.array([1]), np.array([1]), later(seen, np.array([2, 0]), (0, 0, 0)))
    after = at_work.state()
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(after.now, name)[0], value, err_msg=name)
    np.testing.assert_array_equal(after.target.palm_goal_world[0], goal)
    assert np.all(after.action[0] == 0.75) and not after.action[1].any()
    np.testing.assert_array_equal(after.before.object_pose[1], after.now.object_pose[1])
    assert (after.before.object_pose[0] != after.now.object_pose[0]).any()
    first = compose(after.now.object_pose, plan().at(np.zeros(2, int))[0])
    np.testing.assert_allclose(after.target.palm_goal_world[1], first[1], atol=1e-9)


def test_a_world_may_follow_any_plan():
    """Both worlds the ball's, though one of them holds the can."""
    at_work = tracker()
    at_work.begin(np.array([0]), np.array([1]), start().observe())
    target = at_work.state().target
    for name in ("keypoints", "contacts", "mass", "palm_in_object", "size", "center"):
        values = getattr(target, name)
        np.testing.assert_array_equal(values[0], values[1])
    ball = grasps_and_objects()[1]["tennis_ball"]
    np.testing.assert_array_equal(target.size, [ball.size] * 2)


def test_what_is_measured_is_what_is_followed_and_what_is_seen():
    seen = start().observe()
    wrong = replace(
        seen,
        joint_positions=seen.joint_positions + 0.1,
        palm_pose=seen.palm_pose + np.array([0.01, 0, 0, 0, 0, 0, 0]),
        object_pose=seen.object_pose + np.array([0, 0.02, 0, 0, 0, 0, 0]),
    )
    both, goals = [], []
    for observation in (seen, wrong):
        at_work = tracker()
        at_work.begin(np.arange(2), np.arange(2), observation)
        at_work.update(observation)
        both.append(at_work.state().now)
        goals.append(at_work.act(nothing(at_work)).palm_goal_world)
    a, b = both
    np.testing.assert_allclose(b.joints - a.joints, 0.1)
    np.testing.assert_allclose((b.palm_pose - a.palm_pose)[:, :3], [[0.01, 0, 0]] * 2, atol=1e-12)
    np.testing.assert_allclose((b.object_pose - a.object_pose)[:, :3], [[0, 0.02, 0]] * 2, atol=1e-12)
    np.testing.assert_array_equal(a.joint_setpoints, b.joint_setpoints)
    np.testing.assert_allclose((goals[1] - goals[0])[:, :3], [[0, 0.02, 0]] * 2, atol=1e-9)


def test_key_points_and_distances_are_those_of_the_worlds():
    """The ball is put around a fingertip."""
    environment = start()
    engine, at_work = environment.engine, tracker(environment)
    tip = hand().keypoint_names.index(hand().fingers["index"].tip)
    now = at_work.state().now
    pose = engine.object_pose
    pose[1, :3] = transform_points(now.palm_pose, now.keypoints)[1, tip]
    engine.set_state(object_pose=pose)
    at_work.update(environment.observe())
    state = at_work.state()
    now = state.now
    np.testing.assert_array_equal(now.palm_pose, engine.palm_pose)
    np.testing.assert_allclose(now.object_pose, engine.object_pose, atol=1e-9)
    in_world = transform_points(now.palm_pose, now.keypoints)
    model = environment.scene.model
    bodies = {model.body(i).name: i for i in range(model.nbody)}
    known = [i for i, name in enumerate(hand().keypoint_names) if f"hand/{name}" in bodies]
    assert len(known) > 10
    ids = [bodies[f"hand/{hand().keypoint_names[i]}"] for i in known]
    np.testing.assert_allclose(in_world[:, known], engine.batch.bind("xpos")[:, ids], atol=1e-6)
    ball = grasps_and_objects()[1]["tennis_ball"]
    center = transform_points(now.object_pose[1:], ball.center_of_mass[None, None])[0]
    distance = np.linalg.norm(in_world[1] - center, axis=1) - ball.size.max() / 2
    near = distance < 0.02
    assert near.sum() > 1 and now.surface_distance[1, tip] < -0.02
    np.testing.assert_allclose(now.surface_distance[1, near], distance[near], atol=4e-3)
    assert np.isfinite(flatten(state.robot_features())).all()


def test_there_is_no_state_before_the_beginning():
    at_work = PlanTracker(hand(), grasps_and_objects()[1], plan(), 2)
    with pytest.raises(RuntimeError, match="begin comes before"):
        at_work.state()


def test_directions_along_the_links():
    """The thumb's key points in a row, a centimeter apart; all others at the origin."""
    names = list(hand().keypoint_names)
    keypoints = np.zeros((1, len(names), 3))
    thumb = list(hand().fingers).index("thumb")
    links = [len(finger.links) for finger in hand().fingers.values()]
    first = 1 + sum(number + 1 for number in links[:thumb])
    keypoints[0, first : first + links[thumb] + 1, 0] = 0.01 * np.arange(links[thumb] + 1)
    directions = link_directions_of(hand(), keypoints)
    assert directions.shape == (1, len(links), 3, 3)
    np.testing.assert_allclose(directions[0, thumb, :, 0], 0.01)
    assert not np.delete(directions[0], thumb, axis=0).any()
