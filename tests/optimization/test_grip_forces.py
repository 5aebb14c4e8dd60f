"""The squeeze: the softest balanced forces that withstand the loads within friction and torque limits."""

from __future__ import annotations

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand

from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.friction_cones import outside_cones
from fungrasp.optimization.grip_forces import (
    TORQUE_SHARE,
    Fingers,
    elastic_forces,
    holding_forces,
    squeeze_torques,
)
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.wrench_resistance import grip_of

LEVER = np.array([[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]])
"""Two contacts opposite each other, shape [1, 2, 3]."""
DOWN = np.array([[[0.0, 0.0, -1.0, 0.0, 0.0, 0.0]]])
"""A load of one newton across the line between them, shape [1, 1, 6]."""


def fingers(stiffness=100.0, used=(True, True)) -> Fingers:
    """Two fingers of three sliding joints each, x y z."""
    jacobian = np.zeros((1, 2, 3, 6))
    jacobian[0, 0, :, :3] = jacobian[0, 1, :, 3:] = np.eye(3)
    return Fingers(LEVER, -LEVER, jacobian, np.array([used]), np.full((1, 6), stiffness))


def pinch(load: float, least: float, limit: float = 100.0, friction: float = 0.5) -> np.ndarray:
    """Forces of the two fingers, shape [2, 3]."""
    loads, floor, limits = load * DOWN, np.array([least]), np.full(6, limit)
    return holding_forces(fingers(), loads, floor, limits, friction, iterations=3000)[0]


def test_fingers_share_a_load_as_their_stiffness_is():
    even = elastic_forces(fingers(), 2 * DOWN)
    np.testing.assert_allclose(even[0, 0], [[0, 0, 1], [0, 0, 1]], atol=0.01)
    # A push along the line between them; the second finger is three times as stiff.
    stiffness = np.repeat([10.0, 30.0], 3)
    along = elastic_forces(fingers(stiffness), np.array([[[4.0, 0, 0, 0, 0, 0]]]))
    np.testing.assert_allclose(along[0, 0], [[-1, 0, 0], [-3, 0, 0]], atol=0.02)


def test_what_is_not_used_does_not_answer():
    answer = elastic_forces(fingers(used=(True, False)), DOWN)
    assert np.all(answer[0, 0, 1] == 0.0) and answer[0, 0, 0, 2] > 0.1


def test_fingers_press_as_hard_as_friction_needs():
    """Each carries half of 4 N by a friction of 0.5, which takes 4 N of normal force."""
    np.testing.assert_allclose(pinch(4.0, 0.0), [[-4, 0, 0], [4, 0, 0]], atol=0.15)
    np.testing.assert_allclose(pinch(8.0, 0.0), [[-8, 0, 0], [8, 0, 0]], atol=0.3)
    np.testing.assert_allclose(pinch(4.0, 0.0, friction=1.0), [[-2, 0, 0], [2, 0, 0]], atol=0.15)


def test_without_a_load_they_press_as_hard_as_told():
    np.testing.assert_allclose(pinch(0.0, 10.0), [[-5, 0, 0], [5, 0, 0]], atol=0.1)


def test_torque_limits_make_them_softer():
    """Limits are soft: a force at three times its limit is as bad as one four newtons outside its cone."""
    limited, free = (np.abs(pinch(20.0, 0.0, limit=limit)[:, 0]) for limit in (2.0, 100.0))
    np.testing.assert_allclose(free, 20.0, atol=0.5)
    assert np.all(limited < 0.7 * free) and np.all(limited > 2.0)


@pytest.mark.parametrize(
    ("force", "expected"),
    [
        ([0.0, 0.0, 2.0], [0.0, 0.0, 0.0]),
        ([1.0, 0.0, 2.0], [0.0, 0.0, 0.0]),
        # The nearest point of the cone to a force across its axis is half way, at 45 degrees.
        ([2.0, 0.0, 0.0], [1.0, 0.0, -1.0]),
        ([0.0, 0.0, -3.0], [0.0, 0.0, -3.0]),
    ],
)
def test_distance_from_a_cone_of_45_degrees(force, expected):
    up, half = np.array([[[0.0, 0.0, 1.0]]]), 0.5 * np.array([[force]])
    # Two loads add the same, so that what is outside counts twice.
    outside = outside_cones(half, np.stack([half, half], axis=1), 0.0 * up, up, 1.0)
    np.testing.assert_allclose(outside[0, 0], 2 * np.array(expected), atol=1e-12)
    raised = outside_cones(half + 3.0 * up, half[:, None], 3.0 * up, up, 1.0)
    np.testing.assert_allclose(raised[0, 0], expected, atol=1e-12)


def test_torques_of_grasps_grow_with_the_load_to_their_limits():
    grasps, objects = grasps_and_objects()
    names, b = grasps.object_name.tolist(), belief()
    around = CollisionScene.settled(names, b.object_pose, objects)
    palm = grasps.wrist_pose_object
    joints = hand().independent(grasps.joint_positions)
    models = [objects[name] for name in names]
    servos = hand().actuators.values()
    limit = TORQUE_SHARE * np.array([servo.force_limit for servo in servos])
    stiffness = np.tile([servo.kp for servo in servos], (len(grasps), 1))

    points = HandPoints(HandKinematics(hand(), len(grasps)))
    grip = grip_of(points, around, models, palm, joints)

    def torques(weight: float) -> np.ndarray:
        loads = np.zeros((len(grasps), 1, 6))
        loads[:, 0, :3] = -weight * around.up[:, 0]
        least = np.full(len(grasps), weight)
        return squeeze_torques(grip, grasps.link_contacts, stiffness, loads, least)

    soft, twice, firm = torques(0.2), torques(0.4), torques(100.0)
    np.testing.assert_allclose(twice, 2 * soft, atol=0.1 * np.abs(soft).max())
    # Unlimited they would be 500 times the first.
    assert np.abs(500 * soft).max() > 4 * limit.max()
    assert limit.max() < np.abs(firm).max() < 0.6 * np.abs(500 * soft).max()
