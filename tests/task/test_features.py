"""What policy networks get: values computed by hand, and what must not matter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measured_states import action, measured_state, moved, plan_target, privileged

from fungrasp.geometry.poses import invert
from fungrasp.hands import load_hand
from fungrasp.task.features import (
    INPUT_LIMIT,
    LAYOUTS,
    MeasuredState,
    PlanTarget,
    contact_features,
    encoder_parts,
    flatten,
    layout,
    network_input,
    network_parts,
    robot_features,
    value_features,
)
from fungrasp.task.policy import Privileged

HALF = np.sqrt(0.5)
LEFT = [HALF, 0, 0, HALF]
"""A quarter turn about the vertical: the palm's x axis is the world's y axis."""


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro")


def pose(*position: float, turn: list[float] = LEFT) -> np.ndarray:
    return np.array([[*position, *turn]])


def example() -> tuple[MeasuredState, MeasuredState, PlanTarget, np.ndarray]:
    """A palm 20 cm up; the object 10 cm before and below it, not turned: by -90 degrees in the palm's
    frame. Two joints, two key points, two links."""
    straight = [1.0, 0, 0, 0]
    one = np.ones((1, 2))
    now = MeasuredState(
        joints=0.3 * one,
        joint_setpoints=0.4 * one,
        palm_pose=pose(0, 0, 0.2),
        palm_setpoint=pose(0, 0, 0.21),
        object_pose=pose(0, 0.1, 0.1, turn=straight),
        keypoints=np.array([[[0.1, 0, -0.1], [0.1, 0.02, -0.1]]]),
        surface_distance=np.array([[0.01, -1.0]]),
        surface_normal=np.array([[[1.0, 0, 0], [0, 0, 1.0]]]),
    )
    before = MeasuredState(
        joints=0.2 * one,
        joint_setpoints=0.4 * one,
        palm_pose=pose(0, -0.02, 0.2),
        palm_setpoint=pose(0, 0, 0.2),
        object_pose=now.object_pose,
        keypoints=now.keypoints,
        surface_distance=now.surface_distance,
        surface_normal=now.surface_normal,
    )
    goal = PlanTarget(
        palm_goal_world=pose(0, 0.05, 0.2),
        servo_targets=0.5 * one,
        palm_in_object=invert(pose(0.1, 0, -0.15, turn=[HALF, 0, 0, -HALF])),
        keypoints=np.array([[[0.05, 0, 0], [0.0, 0, 0.05]]]),
        surface_distance=np.array([[0.005, 1.0]]),
        surface_normal=np.array([[[0, 1.0, 0], [1.0, 0, 0]]]),
        contacts=np.array([[True, False]]),
        settled_pose=pose(0, 0.05, 0.1, turn=straight),
        mass=np.array([0.3 * np.e]),
        center=np.array([[0.02, 0, 0]]),
        size=np.array([[0.04, 0.08, 0.12]]),
        since_closing=np.array([0.5]),
        since_lift=np.array([-1.0]),
    )
    return now, before, goal, np.array([[0.1] * 8])


EXPECTED: dict[str, list[float]] = {
    "joints": [0.3, 0.3],
    "joint_errors": [1, 1],
    "servo_errors": [0.5, 0.5],
    "joint_changes": [0.5, 0.5],
    "palm_error": [0, 0, 1, 0, 0, 0],
    "palm_change": [-1, 0, 0, 0, 0, 0],
    "palm_goal": [1, 0, 0, 0, 0, 0],
    "up": [0, 0, 1],
    "palm_height": [2],
    "object_center": [1, -0.2, -1],
    "object_extents": [0.8, 0.4, 1.2],
    "object_deviation": [0, 0, 1, 0, 0, 0],
    "object_moved": [1, 0, 0],
    "object_change": [0, -2, 0, 0, 0, 0],
    "keypoint_errors": [0, -1, 0, 0, -0.4, 1],
    "surface_distances": [0.5, -1],
    "surface_normals": [0, -1, 0, 0, 0, 1],
    "target_distances": [0.25, 5],
    "target_normals": [1, 0, 0, 0, -1, 0],
    "target_contacts": [1, 0],
    "mass": [1],
    "phase": [0, 0.5, 0, 0],
    "last_action": [0.1] * 8,
}


def check(parts: dict[str, Any], expected: dict[str, list[float]]) -> None:
    assert list(parts) == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(np.asarray(parts[name])[0], values, atol=1e-12, err_msg=name)


def test_every_part_of_an_observation_by_hand():
    check(robot_features(*example()), EXPECTED)


PAPER = ["joints", "up", "palm_change", "object_center", "object_deviation", "object_change"]
PAPER += ["object_moved", "palm_height", "keypoint_errors", "target_contacts"]
"""phi(s) of the paper, section IV.B.1, without what is privileged."""


def test_what_the_layouts_hold(allegro):
    parts = robot_features(*example())
    assert list(network_parts(parts, "full", encoder=False)) == list(EXPECTED)
    assert list(network_parts(parts, "full", encoder=True)) == list(EXPECTED)
    assert list(network_parts(parts, "paper", encoder=False)) == PAPER
    assert list(network_parts(parts, "paper", encoder=True)) == [*PAPER, "palm_goal", "last_action"]
    assert list(encoder_parts(parts, "paper")) == ["joints", "palm_goal", "target_contacts", "last_action"]
    told = {name for name in EXPECTED if name.startswith(("surface", "target_d", "target_n"))}
    told |= {"servo_errors", "joint_errors", "palm_error"}
    assert not told & {*LAYOUTS["paper"].network, *LAYOUTS["paper"].encoder}, "contacts could be told from it"
    rng = np.random.default_rng(0)
    states = measured_state(rng, allegro, 2), measured_state(rng, allegro, 2)
    parts = robot_features(*states, plan_target(rng, allegro, 2), action(rng, allegro, 2))
    numbers = [flatten(network_parts(parts, "paper", encoder)).shape[1] for encoder in (False, True)]
    assert numbers == [16 + 3 + 6 + 3 + 6 + 6 + 3 + 1 + 3 * 17 + 13, 108 + 6 + 22]


def test_networks_get_a_thrown_object_within_bounds_and_all_else_as_it_is():
    now, before, goal, last = example()
    parts = robot_features(now, before, goal, last)
    np.testing.assert_array_equal(network_input(parts), flatten(parts).astype(np.float32))
    now.object_pose[0, :3] += 20.0
    thrown = network_input(robot_features(now, before, goal, last))
    assert thrown.dtype == np.float32 and np.abs(thrown[0]).max() == INPUT_LIMIT


@pytest.mark.parametrize(
    ("closing", "lift", "expected"),
    [
        (-3.0, -1.0, [-1, 0, 0, 0]),
        (-0.4, -1.0, [-0.4, 0, 0, 0]),
        (9.0, 0.0, [0, 2, 1, 0]),
        (9.0, 5.0, [0, 2, 1, 2]),
    ],
)
def test_the_phase_is_bounded(closing, lift, expected):
    now, before, goal, last = example()
    goal.since_closing[:], goal.since_lift[:] = closing, lift
    np.testing.assert_allclose(robot_features(now, before, goal, last)["phase"][0], expected)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(-3.1, 3.1), x=st.floats(-2, 2), y=st.floats(-2, 2))
def test_where_the_table_stands_does_not_matter(seed, angle, x, y):
    """Everything moved and turned about the vertical."""
    hand, rng = load_hand("allegro"), np.random.default_rng(seed)
    now, before = measured_state(rng, hand, 3), measured_state(rng, hand, 3)
    goal, last = plan_target(rng, hand, 3), action(rng, hand, 3)
    motion = np.array([x, y, 0.0, np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    here = robot_features(now, before, goal, last)
    there = robot_features(moved(now, motion), moved(before, motion), moved(goal, motion), last)
    for name in here:
        np.testing.assert_allclose(here[name], there[name], atol=1e-6, err_msg=name)


def test_height_and_tilt_matter(allegro):
    rng = np.random.default_rng(0)
    now, before = measured_state(rng, allegro, 2), measured_state(rng, allegro, 2)
    goal, last = plan_target(rng, allegro, 2), action(rng, allegro, 2)
    here = robot_features(now, before, goal, last)

    def changed(motion: list[float]) -> set[str]:
        carried = [moved(values, np.array(motion)) for values in (now, before, goal)]
        there = robot_features(*carried, last)
        return {name for name in here if not np.allclose(here[name], there[name], atol=1e-9)}

    assert changed([0, 0, 0.1, 1, 0, 0, 0]) == {"palm_height"}
    assert changed([0, 0, 0, HALF, HALF, 0, 0]) == {"palm_height", "up"}


def test_contacts_that_a_teacher_sees():
    contacts = np.array([[True, False, True]])
    parts = contact_features(contacts, np.array([[5.0, 0.0, 1e9]]), np.array([[True, True, False]]))
    check(
        parts,
        {"contacts": [1, 0, 1], "contact_errors": [0, 1, -1], "contact_forces": [np.tanh(1.0), 0, 1]},
    )
    guessed = contact_features(np.array([[0.9, 0.2, 0.0]]), np.zeros((1, 3)), contacts)
    np.testing.assert_allclose(guessed["contact_errors"][0], [0.1, -0.2, 1.0])


def test_what_only_the_value_network_sees():
    seen = Privileged(
        contacts=np.ones((1, 2), bool),
        forces=np.zeros((1, 2)),
        object_velocity=np.array([[0.0, 0.2, 0.0, 0.0, 0.0, 4.0]]),
        table_forces=np.array([[0.0, 5.0]]),
        self_force=np.array([10.0]),
        object_on_table=np.array([True]),
        object_mass=np.array([0.3 / np.e]),
        friction=np.array([0.7]),
        lifted_height=np.zeros(1),
    )
    expected = {
        "object_velocity": [1, 0, 0],
        "object_spin": [0, 0, 2],
        "table_forces": [0, np.tanh(1.0)],
        "self_force": [np.tanh(2.0)],
        "object_on_table": [1],
        "friction": [0.7],
        "true_mass": [-1],
    }
    check(value_features(seen, example()[0].palm_pose), expected)


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_layouts_follow_the_hand(name):
    hand, rng = load_hand(name), np.random.default_rng(0)
    servos, points, links = len(hand.actuators), len(hand.keypoint_names), len(hand.links)
    now = measured_state(rng, hand, 2)
    parts = robot_features(now, measured_state(rng, hand, 2), plan_target(rng, hand, 2), action(rng, hand, 2))
    sizes = dict(layout(parts))
    assert list(sizes) == list(EXPECTED)
    assert [sizes[key] for key in ("joints", "last_action")] == [servos, servos + 6]
    assert [sizes[key] for key in ("keypoint_errors", "surface_distances")] == [3 * points, points]
    assert [sizes[key] for key in ("target_normals", "target_distances")] == [3 * points, points]
    assert sizes["target_contacts"] == links
    assert flatten(parts).shape == (2, sum(sizes.values()))
    if name == "allegro":
        assert sum(sizes.values()) == 334
    truth = privileged(rng, hand, 2)
    contacts = contact_features(truth.contacts, truth.forces, truth.contacts)
    assert layout(contacts) == (("contacts", links), ("contact_errors", links), ("contact_forces", links))
    more = value_features(truth, now.palm_pose)
    assert flatten(more).shape == (2, 3 + 3 + links + 4)
