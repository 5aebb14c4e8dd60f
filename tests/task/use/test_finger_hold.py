"""Fingers that hold on: joints stay where they were, as far as torques reach."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fungrasp.hands import Hand
from fungrasp.task.use.finger_hold import FingerHold

KP, LIMIT, CONTACT = 4.0, 0.7, 20.0
"""Of the servos [N m/rad] and [N m]; stiffness of what the joints press against [N m/rad]."""


def two_joints() -> Hand:
    servo = SimpleNamespace(kp=KP, force_limit=LIMIT)
    return cast(Any, SimpleNamespace(actuators={"a": servo, "b": servo}))


@pytest.mark.parametrize("load", [0.3, 0.9])
def test_joints_return_to_where_they_were_as_far_as_the_torque_reaches(load):
    """Two joints at rest in a contact, and a load on one of them: 0.9 N m is more than its servo's limit."""
    place = np.array([[0.5, 0.5]])
    joints = place.copy()
    hold = FingerHold(two_joints(), joints, joints)
    pull = np.array([[load, 0.0]])
    moved = []
    for _ in range(60):
        setpoints = hold.keep(joints)
        free = (KP * setpoints + CONTACT * place - pull) / (KP + CONTACT)
        torque = np.clip(KP * (setpoints - free), -LIMIT, LIMIT)
        joints = place + (torque - pull) / CONTACT
        moved.append(joints - place)
    assert abs(moved[-1][0, 1]) < 1e-9
    left = max(load - LIMIT, 0.0) / CONTACT
    assert moved[-1][0, 0] == pytest.approx(-left, abs=1e-3)
    assert abs(moved[0][0, 0]) > left + 0.005, "it gave way at first"


def test_a_setpoint_is_never_farther_from_its_joint_than_the_torque_limit():
    joints = np.array([[0.5, 0.5]])
    hold = FingerHold(two_joints(), joints, joints)
    for _ in range(100):
        setpoints = hold.keep(joints - 0.2)
    np.testing.assert_allclose(setpoints, joints - 0.2 + LIMIT / KP)
    for _ in range(2):
        setpoints = hold.keep(joints + 0.3)
    assert (setpoints < joints + 0.3).all(), "it comes back without delay"
