"""Loads that contacts cannot take."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from retarget_scenes import held, plain_objects

from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.link_contacts import LinkContacts, contacts_of_links
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.wrench_resistance import (
    NO_GRIP,
    Grip,
    lift_loads,
    torque_limits,
    unresisted_load,
    unresisted_share,
)
from fungrasp.retargeting.contact_optimization import initial_pose

UP = np.array([[0.0, 0.0, 1.0]])
ONE = np.ones(1)


def pinch(
    offset: float = 0.0, limit: float = 10.0, friction: float = 0.9, used=(True, True), weight: float = 2.0
):
    """Force and torque that two fingers cannot take, at y = +-1 cm, ``offset`` [m] beside the center along x.
    Each has three joints, which push it along x, y and z with a lever of 0.1 m."""
    place = np.array([[[offset, 0.01, 0.0], [offset, -0.01, 0.0]]])
    inward = np.array([[[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]])
    jacobian = np.zeros((1, 2, 3, 6))
    for finger in range(2):
        jacobian[0, finger, range(3), range(3 * finger, 3 * finger + 3)] = 0.1
    contacts = LinkContacts(place, inward, np.zeros((1, 2)), jacobian)
    grip = Grip(contacts, np.array([used]), np.zeros((1, 3)), 0.05 * ONE, np.full(6, limit), friction)
    force, torque = unresisted_load(grip, weight * ONE, UP, iterations=2000)
    return force[0], torque[0]


def test_a_pinch_at_the_center_of_mass_takes_every_load():
    force, torque = pinch()
    assert force < 0.02 and torque < 1e-3


def test_without_contacts_one_and_a_half_weights_are_left():
    force, torque = pinch(used=(False, False))
    assert force == pytest.approx(1.5 * 2.0) and torque == 0.0


def test_one_finger_takes_next_to_nothing():
    assert pinch(used=(True, False))[0] > 1.0


def test_a_pinch_beside_the_center_lets_the_object_turn():
    """Two points take no torque about the line between them: 1.5 times 2 N over 3 cm, less what they save by
    carrying less of the weight."""
    force, torque = pinch(offset=0.03)
    assert 0.03 < torque < 1.5 * 2.0 * 0.03 and force > 0.1


@pytest.mark.parametrize(("limit", "left"), [(0.05, 2.0), (0.1, 1.0)])
def test_weak_servos_leave_what_they_cannot_take(limit: float, left: float):
    """Each finger lifts ``limit`` over 0.1 m, of the 3 N of the worst load."""
    assert pinch(limit=limit)[0] == pytest.approx(left, abs=0.25)


def test_lifting_takes_the_weight_and_a_disturbance_each_way():
    loads = lift_loads(UP, np.array([2.0]), 0.5)[0]
    assert loads.shape == (6, 6) and np.all(loads[:, 3:] == 0.0)
    np.testing.assert_allclose(np.sort(loads[:, 2]), [-3, -2, -2, -2, -2, -1], atol=1e-12)
    np.testing.assert_allclose(loads[:, :2].sum(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(loads[:, :2], axis=1).max(), 1.0)


def test_slippery_objects_are_held_less():
    """Normal forces are limited to 1 N each: friction 0.3 takes 0.6 N of 3 N."""
    assert pinch(limit=0.1, friction=0.3)[0] > pinch(limit=0.1)[0] + 0.5


def test_torques_and_forces_scale_with_the_weight():
    light, heavy = pinch(offset=0.03), pinch(offset=0.03, weight=4.0, limit=20.0)
    np.testing.assert_allclose(heavy, 2 * np.array(light), rtol=1e-6)


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_shares_of_grasps_and_bounds_between_which_none_is_found(name: str):
    """Of solved grasps, which are in touch; one goes into its object, one is not asked for."""
    points = HandPoints(HandKinematics(load_hand(name), len(held())))
    problem = RetargetingProblem.from_grasps(held(), plain_objects(), points.match)
    objective = [terms.contact_position, terms.contact_gap, terms.object_penetration]
    pose, joints, _ = minimize(points, problem, objective, *initial_pose(points, problem), 40)
    pose[0, :3] = problem.surface[0, 2] - 0.01 * problem.normals[0, 2]
    which = np.array([True, True, False, True, True, True])
    contacts = contacts_of_links(points.dense, problem, pose, joints)
    shares = partial(unresisted_share, contacts, problem, torque_limits(points.kinematics.hand))
    found = shares(upper=np.where(which, np.inf, 0.0))
    assert found[0] == NO_GRIP and found[2] == np.inf
    assert np.any((found > 1e-3) & (found < NO_GRIP))
    # Of no use is what is below the lower bound, or beyond the upper one.
    upper = np.where(which, found + np.array([1, 1, 1, 1, -0.01, -0.01]), 0.0)
    bounded = np.where(upper > 0.2, np.clip(shares(0.2, upper), 0.2, upper), np.inf)
    np.testing.assert_allclose(bounded, np.where(upper > 0.2, np.clip(found, 0.2, upper), np.inf), atol=1e-9)
