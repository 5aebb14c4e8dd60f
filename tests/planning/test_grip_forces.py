"""The squeeze: balanced forces, as many newtons as asked for, within the torque limits."""

from __future__ import annotations

import numpy as np
import pytest
from planned_grasps import belief, grasps_and_objects, hand

from fungrasp.geometry.poses import compose, invert
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.planning.grip_forces import TORQUE_SHARE, limited_forces, squeeze_torques

LEVER = np.array([[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]])
"""Two contacts opposite each other, shape [1, 2, 3]."""


def pinch(normal_force: float, limits: tuple[float, float]) -> np.ndarray:
    """Forces of two fingers of one joint each, whose contact is 0.1 m from it, shape [2, 3]."""
    jacobian = np.zeros((1, 2, 3, 2))
    jacobian[0, 0, 0, 0] = jacobian[0, 1, 0, 1] = 0.1
    used = np.ones((1, 2), dtype=bool)
    asked = np.array([normal_force])
    return limited_forces(LEVER, -LEVER, jacobian, used, asked, np.array(limits), 0.6, iterations=2000)[0]


def test_fingers_press_as_hard_as_asked_and_balance():
    np.testing.assert_allclose(pinch(10.0, (1.0, 1.0)), [[-5, 0, 0], [5, 0, 0]], atol=0.1)


@pytest.mark.parametrize("limits", [(0.3, 0.3), (0.3, 1.0), (1.0, 0.3)])
def test_the_weaker_finger_limits_both(limits):
    """0.3 N m over 0.1 m are 3 N. Asked for 10 N each, both fingers press alike, and far softer."""
    force = pinch(20.0, limits)[:, 0]
    assert force[0] < 0 < force[1] and abs(force.sum()) < 1.5
    assert np.all(np.abs(force) < 0.7 * 10) and np.all(np.abs(force) > 3.0)
    assert np.all(np.abs(pinch(20.0, (2.0, 2.0)))[:, 0] > 9.8)


def test_torques_of_grasps_grow_with_the_force_to_their_limits():
    grasps, objects = grasps_and_objects()
    names, b = grasps.object_name.tolist(), belief()
    around = CollisionScene.settled(names, b.object_pose, objects)
    palm = compose(invert(grasps.object_pose), grasps.wrist_pose)
    joints = hand().independent(grasps.joint_positions)
    models = [objects[name] for name in names]
    limit = TORQUE_SHARE * np.array([servo.force_limit for servo in hand().actuators.values()])

    def torques(force: float) -> np.ndarray:
        asked = np.full(len(grasps), force)
        return squeeze_torques(hand(), around, models, palm, joints, grasps.link_contacts, asked)

    soft, twice, firm = torques(1.0), torques(2.0), torques(100.0)
    np.testing.assert_allclose(twice, 2 * soft, atol=0.1 * np.abs(soft).max())
    # Unlimited they would be a hundred times the first.
    assert np.abs(100 * soft).max() > 4 * limit.max()
    assert limit.max() < np.abs(firm).max() < 0.6 * np.abs(100 * soft).max()
