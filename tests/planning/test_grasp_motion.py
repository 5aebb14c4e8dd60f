"""Planned motions: within the limits, to the end, and what the task then does."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand, motion, start

from fungrasp.geometry.poses import compose
from fungrasp.planning.grasp_motion import Motion, ReferenceSettings, plan_motion, raised, table_height
from fungrasp.policies import ReferenceController
from fungrasp.task import Protocol

P, S = Protocol(), ReferenceSettings()


@pytest.fixture(scope="module")
def planned() -> Motion:
    return motion()


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between orientations [rad]."""
    return 2 * np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))


def test_the_wrist_keeps_its_limits(planned):
    speed = np.linalg.norm(planned.velocity, axis=-1)
    assert 0.1 < speed.max() <= P.wrist_speed + 1e-9
    change = np.linalg.norm(np.diff(planned.velocity, axis=1), axis=-1)
    assert change.max() <= P.control_period * P.wrist_acceleration + 1e-9
    way = np.linalg.norm(np.diff(planned.set_point[..., :3], axis=1), axis=-1)
    assert way.max() <= P.control_period * P.wrist_speed + 1e-9
    turn = turned(planned.set_point[:, 1:, 3:], planned.set_point[:, :-1, 3:])
    assert turn.max() <= P.control_period * P.wrist_rotation_speed + 1e-6


def test_it_comes_to_the_grasp_closes_and_then_lifts(planned):
    steps = round((S.close_time + S.squeeze_time + S.pause) / P.control_period)
    np.testing.assert_array_equal(planned.lift - planned.closing, steps)
    assert planned.lift.max() == planned.wrist_goal.shape[1] - 1
    assert (planned.closing > 5).all() and (planned.lift < P.approach_time / P.control_period).all()
    assert (planned.collision < 0.01).all()
    rows = np.arange(2)
    # Pressed on by a little.
    near = np.linalg.norm(planned.set_point[rows, planned.lift, :3] - planned.wrist[:, :3], axis=-1)
    assert (near < S.press_in + S.press_down + 1e-3).all()
    assert turned(planned.set_point[rows, planned.lift, 3:], planned.wrist[:, 3:]).max() < 1e-3
    offset = planned.finger_targets[rows, planned.lift] - planned.grasp
    assert 0.02 < np.abs(offset).max() <= S.squeeze_limit + 1e-9
    closed = planned.finger_targets[rows, planned.closing + round(S.close_time / P.control_period) - 1]
    np.testing.assert_allclose(closed, planned.grasp, atol=1e-9)


def test_the_task_goes_where_it_was_planned_to_go(planned):
    """The set points of a trial that follows the controller are those of the plan, to the lift."""
    task = start()
    controller = ReferenceController(task, grasps_and_objects()[1])
    for step in range(int(planned.lift.min()) + 1):
        np.testing.assert_allclose(
            task.set_point.pose, compose(task.settled_pose, planned.set_point[:, step]), atol=1e-9
        )
        np.testing.assert_allclose(task.set_point.velocity, planned.velocity[:, step], atol=1e-9)
        action = controller.act()
        np.testing.assert_allclose(
            action.wrist_pose, compose(task.settled_pose, planned.wrist_goal[:, step]), atol=1e-12
        )
        np.testing.assert_array_equal(action.finger_targets, planned.finger_targets[:, step])
        np.testing.assert_array_equal(action.lift, step >= planned.lift)
        task.step(action)
        np.testing.assert_allclose(task.finger_set_point, clipped(task, action.finger_targets), atol=1e-9)


def clipped(task, targets: np.ndarray) -> np.ndarray:
    span = task.scene.model.actuator_ctrlrange[task.scene.finger_actuators]
    return np.clip(targets, span[:, 0], span[:, 1])


def test_a_grasp_is_planned_alone_as_among_others(planned):
    grasps, objects = grasps_and_objects()
    task, one = start(), np.array([1])
    alone = plan_motion(
        hand(),
        grasps.select(one),
        objects,
        task.settled_pose[one],
        task.set_point.pose[one],
        task.finger_set_point[one],
    )
    length = alone.wrist_goal.shape[1]
    assert length == planned.lift[1] + 1 and alone.lift[0] == planned.lift[1]
    for name in ("wrist_goal", "finger_targets", "set_point", "velocity"):
        np.testing.assert_allclose(
            getattr(alone, name)[0], getattr(planned, name)[1, :length], atol=1e-6, err_msg=name
        )


def test_before_its_start_and_after_its_end_it_stays(planned):
    steps = np.array([-3, 10_000])
    goal, fingers = planned.at(steps)
    np.testing.assert_array_equal(goal, np.stack([planned.wrist_goal[0, 0], planned.wrist_goal[1, -1]]))
    np.testing.assert_array_equal(
        fingers, np.stack([planned.finger_targets[0, 0], planned.finger_targets[1, -1]])
    )


def test_rows_can_be_picked_in_any_order(planned):
    rows, steps = np.array([1, 0, 1]), np.array([3, 4, 5])
    goal, fingers = planned.at(steps, rows)
    np.testing.assert_array_equal(goal, planned.wrist_goal[rows, steps])
    np.testing.assert_array_equal(fingers, planned.finger_targets[rows, steps])
    some = planned.select(rows)
    assert len(some) == 3
    for field in fields(Motion):
        np.testing.assert_array_equal(getattr(some, field.name), getattr(planned, field.name)[rows])


@pytest.mark.parametrize("height", [-0.02, 0.02])
def test_the_table_is_where_objects_rest(height):
    """Plans are the same wherever the table is; small errors of a pose don't move it."""
    grasps, objects = grasps_and_objects()
    task = start()
    names = grasps.object_name.tolist()
    moved = raised(task.settled_pose, np.array([height, height]))
    found = table_height(names, moved, objects)
    np.testing.assert_allclose(found, height, atol=0.001)
    near = raised(task.settled_pose, np.array([0.2 * height, 0.1 * height]))
    assert table_height(names, near, objects).tolist() == [0.0, 0.0]
    palm = raised(task.set_point.pose, found)
    there = plan_motion(
        hand(), grasps, objects, raised(task.settled_pose, found), palm, task.finger_set_point
    )
    np.testing.assert_allclose(there.grasp, motion().grasp, atol=0.05)
    np.testing.assert_allclose(there.wrist, motion().wrist, atol=0.002)
