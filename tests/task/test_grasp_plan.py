"""Plans: joined, raised, read at any step, and where their key points are."""

from __future__ import annotations

import numpy as np
from planned_grasps import grasps_and_objects, hand, plan
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.task import GraspPlan


def made_up(seed: int, count: int, steps: int) -> GraspPlan:
    rng = np.random.default_rng(seed)

    def poses(*shape: int) -> np.ndarray:
        turns = Rotation.random(int(np.prod(shape)), rng=rng).as_quat(scalar_first=True)
        return np.concatenate([rng.normal(size=(*shape, 3)), turns.reshape(*shape, 4)], axis=-1)

    return GraspPlan(
        hand="allegro",
        control_period=0.1,
        object_name=np.array([f"thing {seed} {i}" for i in range(count)]),
        object_mass=rng.random(count),
        object_pose=poses(count),
        link_contacts=rng.random((count, 5)) < 0.5,
        keypoints=rng.normal(size=(count, 4, 3)),
        grasp_palm_pose=poses(count),
        grasp_joints=rng.normal(size=(count, 6)),
        palm_goal_object=poses(count, steps),
        finger_targets=rng.normal(size=(count, steps, 6)),
        palm_setpoint_object=poses(count, steps),
        palm_velocity=rng.normal(size=(count, steps, 3)),
        closing_step=rng.integers(0, steps, count),
        lift_step=rng.integers(0, steps, count),
        path_collision=rng.random(count),
    )


def assert_same(a: GraspPlan, b: GraspPlan) -> None:
    assert a.arrays().keys() == b.arrays().keys()
    for name, value in a.arrays().items():
        np.testing.assert_array_equal(value, b.arrays()[name], err_msg=name)


def test_joined_motions_stay_where_they_end():
    short, long = made_up(0, 2, 3), made_up(1, 3, 7)
    both = GraspPlan.join([short, long])
    assert len(both) == 5 and both.palm_goal_object.shape == (5, 7, 7)
    for steps in (np.array([0, 1]), np.array([2, 2]), np.array([4, 99])):
        for ours, theirs in zip(both.at(steps, np.arange(2)), short.at(steps), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(both.palm_setpoint_object[:2, 3:], short.palm_setpoint_object[:, [-1] * 4])
    assert_same(both.select(np.arange(2, 5)), long)
    assert both.object_name.tolist() == ["thing 0 0", "thing 0 1", "thing 1 0", "thing 1 1", "thing 1 2"]


def test_before_its_start_and_after_its_end_it_stays():
    goal, fingers = plan().at(np.array([-3, 10_000]))
    np.testing.assert_array_equal(
        goal, np.stack([plan().palm_goal_object[0, 0], plan().palm_goal_object[1, -1]])
    )
    np.testing.assert_array_equal(
        fingers, np.stack([plan().finger_targets[0, 0], plan().finger_targets[1, -1]])
    )


def test_rows_can_be_picked_in_any_order():
    rows, steps = np.array([1, 0, 1]), np.array([3, 4, 5])
    goal, fingers = plan().at(steps, rows)
    np.testing.assert_array_equal(goal, plan().palm_goal_object[rows, steps])
    np.testing.assert_array_equal(fingers, plan().finger_targets[rows, steps])


def test_raised_plans_are_for_objects_that_rest_higher():
    height = np.array([0.02, -0.01])
    higher = plan().raised(height)
    np.testing.assert_allclose(higher.object_pose[:, 2] - plan().object_pose[:, 2], height, atol=1e-12)
    assert_same(higher.raised(-height).select(slice(0)), plan().select(slice(0)))
    np.testing.assert_array_equal(higher.palm_goal_object, plan().palm_goal_object)


def test_key_points_are_those_of_the_grasp_in_the_objects_frame():
    p = plan()
    kinematics = HandKinematics(hand(), 2)
    world = kinematics.keypoints(compose(p.object_pose, p.grasp_palm_pose), hand().all_joints(p.grasp_joints))
    np.testing.assert_allclose(transform_points(p.object_pose, p.keypoints), world, atol=1e-9)
    grasps, _ = grasps_and_objects()
    np.testing.assert_array_equal(p.link_contacts, grasps.link_contacts)
    np.testing.assert_array_equal(p.object_mass, grasps.object_mass)
