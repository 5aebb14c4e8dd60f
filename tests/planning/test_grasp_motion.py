"""Planned motions: within the limits, to the end, for what is believed, and what the task then does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand, plan, start

from fungrasp.geometry.poses import compose
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.problem import CollisionScene
from fungrasp.planning import MotionPlanner
from fungrasp.planning.grasp_motion import TABLE_TOLERANCE, MotionSettings, lowered, table_below
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retargeting import retarget
from fungrasp.simulation import build_scene
from fungrasp.task import Belief, GraspPlan, LiftEnvironment, LiftProtocol

P, S = LiftProtocol(), MotionSettings()


def planned(believed: Belief, **options) -> GraspPlan:
    grasps, objects = grasps_and_objects()
    return MotionPlanner(hand(), objects, **options).plan(grasps, believed)


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between orientations [rad]."""
    return 2 * np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))


def raised(pose: np.ndarray, height: float | np.ndarray) -> np.ndarray:
    result = pose.copy()
    result[:, 2] += height
    return result


@pytest.mark.parametrize("protocol", [P, LiftProtocol(wrist_speed=0.15, wrist_acceleration=0.2)])
def test_the_wrist_keeps_its_limits(protocol):
    p = plan() if protocol is P else planned(belief(), protocol=protocol)
    speed = np.linalg.norm(p.palm_velocity, axis=-1)
    assert 0.1 < speed.max() <= protocol.wrist_speed + 1e-9
    change = np.linalg.norm(np.diff(p.palm_velocity, axis=1), axis=-1)
    assert change.max() <= P.control_period * protocol.wrist_acceleration + 1e-9
    way = np.linalg.norm(np.diff(p.palm_setpoint_object[..., :3], axis=1), axis=-1)
    assert way.max() <= P.control_period * protocol.wrist_speed + 1e-9
    turn = turned(p.palm_setpoint_object[:, 1:, 3:], p.palm_setpoint_object[:, :-1, 3:])
    assert turn.max() <= P.control_period * P.wrist_rotation_speed + 1e-6


def test_it_comes_to_the_grasp_closes_and_then_lifts():
    p = plan()
    steps = round((S.close_time + S.squeeze_time + S.pause) / P.control_period)
    np.testing.assert_array_equal(p.lift_step - p.closing_step, steps)
    assert p.lift_step.max() == p.palm_goal_object.shape[1] - 1
    assert (p.closing_step > 5).all() and (p.lift_step < P.approach_time / P.control_period).all()
    assert (p.path_collision < 0.01).all()
    rows = np.arange(2)
    # Pressed on by a little.
    at_lift = p.palm_setpoint_object[rows, p.lift_step]
    near = np.linalg.norm(at_lift[:, :3] - p.grasp_palm_pose[:, :3], axis=-1)
    assert (near < S.press_in + S.press_down + 1e-3).all()
    assert turned(at_lift[:, 3:], p.grasp_palm_pose[:, 3:]).max() < 1e-3
    offset = p.finger_targets[rows, p.lift_step] - p.grasp_joints
    assert 0.02 < np.abs(offset).max() <= S.squeeze_limit + 1e-9
    closed = p.finger_targets[rows, p.closing_step + round(S.close_time / P.control_period) - 1]
    np.testing.assert_allclose(closed, p.grasp_joints, atol=1e-9)


def test_nothing_is_struck_before_the_fingers_close():
    """Handles of pitchers and drills, which a wrist that cuts corners goes through, and so do fingers that
    start to close from the other side of them."""
    human = builtin_grasps()
    human = human.select(np.flatnonzero(np.isin(human.object_name, ("pitcher", "drill"))))
    objects = load_objects(human)
    grasps = retarget(human, objects, hand(), threads=1)
    believed = LiftEnvironment(build_scene(hand(), objects), len(grasps), threads=1).settle(grasps)
    p = MotionPlanner(hand(), objects, MotionSettings(adapt=None)).plan(grasps, believed)
    names = grasps.object_name.tolist()
    around = CollisionScene.settled(names, believed.object_pose, objects)
    points = HandPoints(HandKinematics(hand(), len(grasps)))
    for step in range(int(p.closing_step.max())):
        state = HandState(points, around, p.palm_setpoint_object[:, step], p.finger_targets[:, step])
        going = step < p.closing_step
        assert state.clearance[going].min() > -0.002


def test_fingers_close_within_a_handle_and_not_through_it():
    human = builtin_grasps().select(np.array([15, 16, 17]))  # a pitcher's handle, to pour
    objects = load_objects(human)
    grasps = retarget(human, objects, hand(), progress=False)
    believed = LiftEnvironment(build_scene(hand(), objects), 3).settle(grasps)
    p = MotionPlanner(hand(), objects).plan(grasps, believed)
    rows = np.arange(3)
    opened = p.finger_targets[rows, p.closing_step - 1]
    around = CollisionScene.settled(p.object_name.tolist(), p.object_pose, objects)
    points = HandPoints(HandKinematics(hand(), 3))
    deepest = [
        HandState(points, around, p.grasp_palm_pose, opened + share * (p.grasp_joints - opened))
        .clearance.min(axis=1)
        .min()
        for share in np.linspace(0.0, 1.0, 11)
    ]
    assert min(deepest) > -0.002


def test_the_task_goes_where_it_was_planned_to_go():
    """The setpoints of an episode that follows the plan are those of the plan, to the lift."""
    environment, policy, p = start(), OpenLoopPolicy(), plan()
    task, low, high = environment.task, *environment.scene.servo_limits.T
    policy.reset(p, environment.observe())
    for step in range(int(p.lift_step.min()) + 1):
        setpoint = task.setpoints.wrist
        np.testing.assert_allclose(
            setpoint.pose, compose(task.settled_pose, p.palm_setpoint_object[:, step]), atol=1e-9
        )
        np.testing.assert_allclose(setpoint.velocity, p.palm_velocity[:, step], atol=1e-9)
        action = policy.act(environment.observe())
        goal = compose(task.settled_pose, p.palm_goal_object[:, step])
        np.testing.assert_allclose(action.palm_goal_world, goal, atol=1e-12)
        np.testing.assert_array_equal(action.finger_targets, p.finger_targets[:, step])
        np.testing.assert_array_equal(action.lift, step >= p.lift_step)
        environment.step(action)
        np.testing.assert_allclose(
            task.setpoints.fingers, np.clip(action.finger_targets, low, high), atol=1e-9
        )


def test_it_says_what_it_was_planned_for():
    grasps, _ = grasps_and_objects()
    p = plan()
    assert p.hand == "allegro" and p.control_period == P.control_period
    assert p.object_name.tolist() == grasps.object_name.tolist()
    np.testing.assert_array_equal(p.object_pose, belief().object_pose)
    np.testing.assert_array_equal(p.object_mass, belief().object_mass)
    np.testing.assert_allclose(
        compose(p.object_pose, p.palm_setpoint_object[:, 0]), belief().palm_pose, atol=1e-9
    )
    assert p.rollouts is None and p.expected_success is None


# What is believed


def test_plans_are_for_the_pose_that_is_believed():
    """Nothing but the belief says where the object is."""
    shift = np.array([0.05, -0.03, 0.0, 0, 0, 0, 0])
    elsewhere = replace(
        belief(), object_pose=belief().object_pose + shift, palm_pose=belief().palm_pose + shift
    )
    there, here = planned(elsewhere), plan()
    np.testing.assert_array_equal(there.object_pose, elsewhere.object_pose)
    np.testing.assert_allclose(there.palm_goal_object, here.palm_goal_object, atol=1e-4)
    np.testing.assert_allclose(there.finger_targets, here.finger_targets, atol=1e-3)


def test_the_hand_starts_where_it_is_believed_to_be():
    farther = replace(belief(), palm_pose=belief().palm_pose + np.array([0, 0, 0.05, 0, 0, 0, 0]))
    p = planned(farther)
    np.testing.assert_allclose(
        compose(p.object_pose, p.palm_setpoint_object[:, 0]), farther.palm_pose, atol=1e-9
    )
    open_hand = replace(belief(), joint_positions=0.0 * belief().joint_positions)
    first = planned(open_hand).finger_targets[:, 0]
    assert np.abs(first - plan().finger_targets[:, 0]).max() > 0.1


def squeeze(p: GraspPlan) -> np.ndarray:
    """Offsets of the servo targets at the end [rad], shape [2, U]."""
    return p.finger_targets[np.arange(2), p.lift_step] - p.grasp_joints


def test_a_soft_hand_squeezes_farther_and_a_light_object_is_squeezed_softer():
    nominal = squeeze(plan())
    # Of fingers that are all softer by as much, each still carries the same share of a load.
    soft = squeeze(planned(replace(belief(), servo_stiffness=np.full((2, 16), 0.5))))
    free = np.abs(2 * nominal) < S.squeeze_limit - 1e-6
    assert free.sum() > 16
    np.testing.assert_allclose(soft[free], 2 * nominal[free], atol=0.1 * np.abs(nominal).max())
    light = squeeze(planned(replace(belief(), object_mass=0.1 * belief().object_mass)))
    assert (np.abs(light).sum(axis=1) < 0.9 * np.abs(nominal).sum(axis=1)).all()


def test_grasps_may_have_settings_of_their_own():
    grasps, objects = grasps_and_objects()
    extra = {"force_scale": np.array([0.5, 1.0]), "press_in": np.array([0.0, S.press_in])}
    p = MotionPlanner(hand(), objects).plan(replace(grasps, extra=extra), belief())
    assert np.abs(squeeze(p)[0]).sum() < 0.9 * np.abs(squeeze(plan())[0]).sum()
    np.testing.assert_allclose(squeeze(p)[1], squeeze(plan())[1], atol=1e-9)
    moved = np.linalg.norm(p.palm_goal_object[:, -1, :3] - plan().palm_goal_object[:, -1, :3], axis=1)
    np.testing.assert_allclose(moved, [S.press_in, 0.0], atol=1e-6)


@pytest.mark.parametrize("height", [-0.02, 0.02])
def test_the_table_is_where_objects_rest(height):
    """Plans are the same wherever the table is; small errors of a pose don't move it."""
    grasps, objects = grasps_and_objects()
    names, zero = grasps.object_name.tolist(), np.zeros(2)
    rest = belief().object_pose
    found = table_below(names, raised(rest, height), zero, objects)
    np.testing.assert_allclose(found, height, atol=0.001)
    near = raised(rest, np.array([0.2 * height, 0.1 * height]))
    assert table_below(names, near, zero, objects).tolist() == [0.0, 0.0]
    higher = replace(belief(), object_pose=raised(rest, found), palm_pose=raised(belief().palm_pose, found))
    for believed in (higher, replace(higher, table_height=found)):
        there = planned(believed)
        np.testing.assert_allclose(there.grasp_joints, plan().grasp_joints, atol=0.05)
        np.testing.assert_allclose(there.grasp_palm_pose, plan().grasp_palm_pose, atol=0.002)


def test_a_believed_table_is_believed_within_the_tolerance():
    grasps, objects = grasps_and_objects()
    names, rest = grasps.object_name.tolist(), belief().object_pose
    near = np.full(2, 0.8 * TABLE_TOLERANCE)
    np.testing.assert_array_equal(table_below(names, rest, near, objects), near)
    far = np.full(2, 2 * TABLE_TOLERANCE)
    np.testing.assert_allclose(table_below(names, rest, far, objects), 0.0, atol=0.001)


def test_what_is_lowered_onto_its_table_has_it_at_zero():
    height = np.array([0.02, -0.01])
    low = lowered(replace(belief(), table_height=np.array([0.02, 0.0])), height)
    np.testing.assert_array_equal(low.table_height, 0.0)
    np.testing.assert_allclose(raised(low.object_pose, height), belief().object_pose, atol=1e-12)
    np.testing.assert_allclose(raised(low.palm_pose, height), belief().palm_pose, atol=1e-12)
    np.testing.assert_array_equal(low.joint_positions, belief().joint_positions)


def test_without_adaptation_grasps_move_with_the_object_unchanged():
    grasps, _ = grasps_and_objects()
    p = planned(belief(), settings=MotionSettings(adapt=None))
    in_object = grasps.wrist_pose_object
    np.testing.assert_allclose(p.grasp_palm_pose, in_object, atol=1e-12)
    np.testing.assert_allclose(p.grasp_joints, hand().independent(grasps.joint_positions), atol=1e-12)
    assert np.abs(plan().grasp_joints - p.grasp_joints).max() > 1e-4
