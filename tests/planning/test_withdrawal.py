"""The way of the hand between two attempts."""

from __future__ import annotations

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand, plan, start

from fungrasp.geometry.poses import compose, inverse_transform_points, quaternion_from_rotation_vector
from fungrasp.planning.attempts import next_belief, within_reach
from fungrasp.planning.withdrawal import WAY_ROUND, WaypointPolicy, Waypoints, way_off, way_round
from fungrasp.task import LiftEnvironment, LiftProtocol, Observation


def names() -> list[str]:
    return grasps_and_objects()[0].object_name.tolist()


def raised(observation: Observation) -> Observation:
    """With the palms where they are after a lift, fingers closed."""
    palm = compose(plan().object_pose, plan().grasp_palm_pose)
    palm[:, 2] += 0.15
    observation.palm_setpoint[:] = palm
    observation.joint_setpoints[:] = plan().finger_targets[:, -1]
    return observation


def test_what_hangs_in_the_hand_is_lowered_before_the_hand_opens():
    seen = raised(start().observe())
    ways = way_off(plan(), seen, np.array([0.0, 0.12]))
    # One stays where it is, the other goes down first.
    np.testing.assert_allclose(ways.palm[:, 0, 2], seen.palm_setpoint[:, 2] - [0.0, 0.12])
    np.testing.assert_allclose(ways.fingers[:, 0], seen.joint_setpoints)
    assert (ways.near[:, 0] < 0.01).all()


def test_the_hand_withdraws_by_the_planned_path_backwards():
    seen = raised(start().observe())
    ways = way_off(plan(), seen, np.zeros(2))
    planned = compose(plan().object_pose, plan().palm_setpoint_object[:, 0])
    closing = plan().palm_setpoint_object[np.arange(2), plan().closing_step]
    moved = seen.palm_setpoint[:, :3] - compose(plan().object_pose, closing)[:, :3]
    np.testing.assert_allclose(ways.palm[:, -1, :3], planned[:, :3] + moved, atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(ways.palm[:, -1, 3:] * planned[:, 3:], axis=1)), 1.0)
    assert np.abs(ways.fingers[:, -1] - plan().finger_targets[:, 0]).max() < 1e-9


def test_the_way_round_keeps_away_from_the_object_and_ends_at_the_start():
    grasps, objects = grasps_and_objects()
    turned = belief().object_pose.copy()
    half = quaternion_from_rotation_vector(np.array([0.0, 0.0, np.pi]))
    turned = compose(turned, np.tile(np.concatenate([np.zeros(3), half]), (2, 1)))
    after = next_belief(belief(), turned, grasps, hand(), objects, LiftProtocol())
    seen = start().observe()
    assert np.linalg.norm(after.palm_pose[:, :3] - seen.palm_setpoint[:, :3], axis=1).min() > 0.2
    ways = way_round(seen, turned, objects, names(), after.palm_pose, after.joint_positions)
    np.testing.assert_allclose(ways.palm[:, -1, :3], after.palm_pose[:, :3], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(ways.palm[:, -1, 3:] * after.palm_pose[:, 3:], axis=1)), 1.0)
    np.testing.assert_allclose(ways.fingers[:, -1], after.joint_positions)
    for w, name in enumerate(names()):
        between = ways.palm[w, :-1, :3]
        surface = objects[name].vertices
        local = inverse_transform_points(turned[w : w + 1], between[None])[0]
        gap = np.linalg.norm(local[:, None] - surface[None], axis=-1).min()
        assert gap > 0.8 * WAY_ROUND


def test_a_start_where_the_hand_is_already_takes_no_way():
    objects = grasps_and_objects()[1]
    seen, b = start().observe(), belief()
    ways = way_round(seen, b.object_pose, objects, names(), seen.palm_setpoint, seen.joint_setpoints)
    assert np.isfinite(ways.palm).all()
    np.testing.assert_allclose(ways.palm[:, -1, :3], seen.palm_setpoint[:, :3], atol=1e-9)


def test_the_belief_of_another_attempt_is_the_first_where_nothing_moved():
    grasps, objects = grasps_and_objects()
    same = next_belief(belief(), belief().object_pose, grasps, hand(), objects, LiftProtocol())
    for name, value in belief().arrays().items():
        np.testing.assert_allclose(same.arrays()[name], value, atol=1e-9, err_msg=name)


def test_what_fell_off_the_table_or_rolled_away_is_not_within_reach():
    pose, objects = belief().object_pose, grasps_and_objects()[1]
    for shift, expected in (((0.2, 0.2, 0.0), True), ((0.5, 0.0, 0.0), False), ((0.0, 0.0, -0.7), False)):
        moved = pose.copy()
        moved[:, :3] += shift
        assert within_reach(moved, pose, names(), objects).tolist() == [expected] * 2


def step(environment: LiftEnvironment, policy: WaypointPolicy, steps: int) -> int:
    """Steps until all have arrived."""
    for number in range(steps):
        action = policy.act(environment.observe())
        if policy.arrived.all():
            return number
        environment.step(action)
    return steps


def test_way_points_are_passed_by_and_the_last_is_reached():
    environment = start()
    first = environment.observe()
    palm = np.repeat(first.palm_setpoint[:, None], 3, axis=1)
    palm[:, 1:, 2] += 0.1
    palm[:, 2, 0] += 0.1
    fingers = np.repeat(first.joint_setpoints[:, None], 3, axis=1)
    near = np.tile([0.05, 0.05, 0.002], (2, 1))
    policy = WaypointPolicy(Waypoints(palm, fingers, near))
    assert 5 < step(environment, policy, 100) < 40
    np.testing.assert_allclose(environment.observe().palm_setpoint[:, :3], palm[:, -1, :3], atol=0.002)
    assert environment.observe().time_since_lift == pytest.approx([-1.0, -1.0])
