"""Policies from files at work: what their network says is what is done, and what does not fit is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand, plan, start, tracker
from residual_policies import ACTION, SETTINGS, SIZE, policy_file

from fungrasp.core.errors import FungraspError
from fungrasp.planning import make_planner
from fungrasp.policies import OpenLoopPolicy, StudentPolicy, TeacherPolicy, make_policy
from fungrasp.policies.checkpoint.card import ActionPart
from fungrasp.policies.checkpoint.checkpoint_file import load_policy
from fungrasp.policies.residual_policy import ACTION_PARTS, residual_settings
from fungrasp.task import Action, LiftEnvironment, Policy, PrivilegedPolicy


def made(path) -> StudentPolicy | TeacherPolicy:
    policy = make_policy(str(path), hand(), grasps_and_objects()[1])
    assert isinstance(policy, StudentPolicy | TeacherPolicy)
    return policy


def act(policy: StudentPolicy | TeacherPolicy, environment: LiftEnvironment) -> Action:
    if isinstance(policy, TeacherPolicy):
        return policy.act_privileged(environment.observe(), environment.privileged())
    return policy.act(environment.observe())


def keep_in_place(environment: LiftEnvironment) -> None:
    """Put the objects back: they are touched on the hand's way, and a policy follows them."""
    engine = environment.engine
    palm, joints = environment.task.setpoints.wrist, environment.task.setpoints.fingers
    engine.set_state(
        object_pose=environment.task.settled_pose,
        palm_pose=palm.pose,
        palm_velocity=palm.velocity,
        joint_positions=hand().all_joints(joints),
    )


@pytest.mark.parametrize("kind", ["student", "teacher"])
def test_a_policy_that_changes_nothing_plays_the_plan(tmp_path, kind):
    environment, other = start(), start()
    policy, reference = made(policy_file(tmp_path, kind=kind)), OpenLoopPolicy()
    assert isinstance(policy, Policy) == (kind == "student")
    assert isinstance(policy, PrivilegedPolicy) == (kind == "teacher")
    policy.reset(plan(), environment.observe())
    reference.reset(plan(), other.observe())
    while not (environment.task.time >= 0.1 * (plan().lift_step.max() + 2)).all():
        for one in (environment, other):
            keep_in_place(one)
        # The objects stay where they are: once the palm rises they seem to sink, which is answered.
        on = ~(environment.task.lift_time < environment.task.time)
        ours, theirs = act(policy, environment), reference.act(other.observe())
        np.testing.assert_allclose(ours.palm_goal_world[on], theirs.palm_goal_world[on], atol=1e-9)
        np.testing.assert_array_equal(ours.finger_targets[on], theirs.finger_targets[on])
        np.testing.assert_array_equal(ours.lift, theirs.lift)
        environment.step(ours)
        other.step(theirs)
    np.testing.assert_array_equal(environment.task.lift_time, other.task.lift_time)
    assert np.isfinite(environment.task.lift_time).all()


def test_a_networks_actions_are_residuals_of_the_cards_size(tmp_path):
    offset = np.linspace(-1.5, 1.5, SIZE)
    environment, other = start(), start()
    policy, follower = made(policy_file(tmp_path, offset)), tracker(other, settings=SETTINGS)
    policy.reset(plan(), environment.observe())
    for _ in range(3):
        follower.update(other.observe())
        ours, theirs = act(policy, environment), follower.act(np.tile(offset, (2, 1)))
        np.testing.assert_allclose(ours.palm_goal_world, theirs.palm_goal_world, atol=1e-7)
        np.testing.assert_allclose(ours.finger_targets, theirs.finger_targets, atol=1e-7)
        environment.step(ours)
        other.step(theirs)


def test_it_sees_what_happens_to_the_object_of_its_world(tmp_path):
    """The first number of the action moves the palm along its x axis."""
    path, seen = policy_file(tmp_path, watch=("object_deviation", 0.1)), start().observe()
    moved = replace(seen, object_pose=seen.object_pose.copy())
    moved.object_pose[1, :3] += [0.02, 0.02, 0.01]
    actions = []
    for observation in (seen, moved):
        policy = made(path)
        policy.reset(plan(), seen)
        actions.append(policy.act(observation))
    np.testing.assert_array_equal(actions[0].palm_goal_world[0], actions[1].palm_goal_world[0])
    nothing = tracker()
    nothing.update(moved)
    change = actions[1].palm_goal_world - nothing.act(np.zeros((2, SIZE))).palm_goal_world
    before = actions[0].palm_goal_world - tracker().act(np.zeros((2, SIZE))).palm_goal_world
    assert np.linalg.norm((change - before)[1, :3]) > 0.01 * SETTINGS.position


def test_a_teacher_sees_contacts(tmp_path):
    """As the first of them: whether the palm should touch and does not."""
    environment = start()
    policy = made(policy_file(tmp_path, watch=("contact_errors", 1.0), kind="teacher"))
    policy.reset(plan(), environment.observe())
    moved = act(policy, environment).palm_goal_world - tracker().act(np.zeros((2, SIZE))).palm_goal_world
    wanted = grasps_and_objects()[0].link_contacts[:, 0]
    expected = 0.5 * SETTINGS.position * wanted
    np.testing.assert_allclose(np.linalg.norm(moved[:, :3], axis=1), expected, atol=1e-9)


def test_a_broken_world_does_not_stop_the_others(tmp_path):
    path, seen = policy_file(tmp_path, watch=("object_deviation", 0.1)), start().observe()
    broken, whole = made(path), made(path)
    for policy in (broken, whole):
        policy.reset(plan(), seen)
    for step in range(2):
        bad = replace(seen, object_pose=seen.object_pose.copy(), palm_pose=seen.palm_pose.copy())
        if step:
            bad.object_pose[1], bad.palm_pose[1] = np.nan, np.nan
        ours, theirs = broken.act(bad), whole.act(seen)
        np.testing.assert_array_equal(ours.palm_goal_world[0], theirs.palm_goal_world[0])
        np.testing.assert_array_equal(ours.finger_targets[0], theirs.finger_targets[0])


def test_a_policy_may_be_reset_for_other_plans_and_another_number_of_worlds(tmp_path):
    path, seen = policy_file(tmp_path, np.linspace(-1, 1, SIZE)), start().observe()
    used, fresh, one = made(path), made(path), np.array([1])
    used.reset(plan(), seen)
    used.act(seen)
    for policy in (used, fresh):
        policy.reset(plan().select(one), seen.select(one))
    for _ in range(2):
        ours, theirs = used.act(seen.select(one)), fresh.act(seen.select(one))
        np.testing.assert_array_equal(ours.palm_goal_world, theirs.palm_goal_world)
        np.testing.assert_array_equal(ours.finger_targets, theirs.finger_targets)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hand": "leap"}, "made for the hand 'leap', not 'allegro'"),
        ({"rate_hz": 20.0}, "acts at 20 Hz, here at 10 Hz"),
    ],
)
def test_policies_made_for_something_else_are_refused(change, words, tmp_path):
    """When they are made, or, where it takes a plan to know, when they are reset; ``test_policy_fit`` has all
    that may differ."""
    path, seen = policy_file(tmp_path, **change), start().observe()
    with pytest.raises(FungraspError, match=words):
        make_policy(str(path), hand(), grasps_and_objects()[1]).reset(plan(), seen)


def test_no_planner_is_made_for_a_policy_of_another_hand(tmp_path):
    """Before anything is planned."""
    (tmp_path / "likes.onnx").write_bytes(policy_file(tmp_path).read_bytes())
    path = policy_file(tmp_path, hand="leap", plans="likes")
    with pytest.raises(FungraspError, match="made for the hand 'leap'"):
        make_planner(str(path), hand(), grasps_and_objects()[1])


def test_the_card_says_how_far_actions_go(tmp_path):
    assert residual_settings(load_policy(policy_file(tmp_path)).card) == SETTINGS
    steps = zip(ACTION_PARTS["guided"], ACTION, strict=True)
    path = policy_file(tmp_path, action=tuple(ActionPart(name, *part[1:]) for name, part in steps))
    assert residual_settings(load_policy(path).card) == replace(SETTINGS, base="guided")
