"""Loads of the lift and of use motions, against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, hand

from fungrasp.objects.object_model import GRAVITY
from fungrasp.optimization.wrench_resistance import lift_loads
from fungrasp.planning.expected_loads import use_loads
from fungrasp.task.use import UseMotion, load_use_motions

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
PALM = np.array([-0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""10 cm beside the object's origin, along the world's axes."""


def of_motion(motion: UseMotion, mass: float = 0.5) -> np.ndarray:
    objects = grasps_and_objects()[1]
    return use_loads(motion, hand(), objects["tennis_ball"], UPRIGHT, PALM, np.zeros(16), mass)


def test_lifting_takes_the_weight_and_a_disturbance_each_way():
    loads = lift_loads(np.array([[0.0, 0.0, 1.0]]), np.array([2.0]), 0.5)[0]
    assert loads.shape == (6, 6) and np.all(loads[:, 3:] == 0.0)
    np.testing.assert_allclose(np.sort(loads[:, 2]), [-3, -2, -2, -2, -2, -1], atol=1e-12)
    np.testing.assert_allclose(loads[:, :2].sum(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(loads[:, :2], axis=1).max(), 1.0)


def test_what_is_handed_over_is_pulled_away_from_the_palm():
    weight = GRAVITY * 0.5
    loads = of_motion(load_use_motions()["hand_over"])
    np.testing.assert_allclose(loads[0], [0, 0, -weight, 0, 0, 0], atol=1e-9)
    pull = loads[1, :3] - loads[0, :3]
    assert np.linalg.norm(pull) == pytest.approx(10.0) and pull[0] > 9.0
    # The far end of a ball lies behind its center as seen from the palm.
    np.testing.assert_allclose(loads[1, 3:], 0.0, atol=0.03)


def test_what_is_screwed_is_turned_both_ways():
    loads = of_motion(load_use_motions()["screw"])
    np.testing.assert_allclose(loads[1, 3:], -loads[2, 3:])
    assert np.linalg.norm(loads[1, 3:]) == pytest.approx(0.1)


def test_weight_turns_as_the_palm_tilts():
    """By 90 degrees: gravity is then horizontal in the object's frame, and as large."""
    motion = UseMotion("tip", ("drink",), 1.0, turn="tilt", segments=((np.pi / 2, 100.0, 50.0),))
    loads = of_motion(motion)
    for load in loads[1:]:
        assert abs(load[2]) < 0.01 and np.linalg.norm(load[:3]) == pytest.approx(GRAVITY * 0.5, abs=0.01)


def test_a_sudden_turn_adds_what_moves_the_mass():
    """60 degrees within 0.2 s, half of it speeding up: 0.1 m away that is 105 rad/s^2, or 10.5 m/s^2."""
    motion = UseMotion("swing", ("hammer",), 0.2, turn="swing", segments=((np.pi / 3, 0.2, 0.1),))
    loads = of_motion(motion)
    sideways = 0.5 * (loads[2] - loads[1])[:3]
    assert np.linalg.norm(sideways) == pytest.approx(0.5 * (np.pi / 3) / 0.1 / 0.1 * 0.1, rel=0.05)


def test_a_trigger_is_pressed_straight_into_the_object():
    """Through the center of a ball, wherever the fingertip is: no torque."""
    loads = of_motion(load_use_motions()["pull_trigger"])
    press = loads[1] - loads[0]
    assert np.linalg.norm(press[:3]) == pytest.approx(5.0, abs=0.05)
    np.testing.assert_allclose(press[3:], 0.0, atol=0.02)
