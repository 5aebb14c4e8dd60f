"""Loads that contacts cannot take."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.optimization.link_contacts import LinkContacts
from fungrasp.optimization.wrench_resistance import Grip, unresisted_load

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


def test_slippery_objects_are_held_less():
    """Normal forces are limited to 1 N each: friction 0.3 takes 0.6 N of 3 N."""
    assert pinch(limit=0.1, friction=0.3)[0] > pinch(limit=0.1)[0] + 0.5


def test_torques_and_forces_scale_with_the_weight():
    light, heavy = pinch(offset=0.03), pinch(offset=0.03, weight=4.0, limit=20.0)
    np.testing.assert_allclose(heavy, 2 * np.array(light), rtol=1e-6)
