"""What a policy sees: values computed by hand, and what must not matter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from views import action, as_torch, moved, readings, sensed, wanted

from fungrasp.geometry.poses import compose, invert
from fungrasp.hands import load_hand
from fungrasp.task.observation import (
    Readings,
    Sensed,
    Wanted,
    critic,
    flatten,
    layout,
    observe,
    privileged,
)

HALF = np.sqrt(0.5)
LEFT = [HALF, 0, 0, HALF]
"""A quarter turn about the vertical: the palm's x axis is the world's y axis."""


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro")


def pose(*position: float, turn: list[float] = LEFT) -> np.ndarray:
    return np.array([[*position, *turn]])


def example() -> tuple[Readings, Readings, Wanted, np.ndarray]:
    """A palm 20 cm up; the object 10 cm before and below it, not turned: by -90 degrees in the palm's
    frame. Two joints, two key points, two links."""
    straight = [1.0, 0, 0, 0]
    one = np.ones((1, 2))
    now = Readings(
        joints=0.3 * one,
        servo_targets=0.4 * one,
        palm_pose=pose(0, 0, 0.2),
        palm_set_point=pose(0, 0, 0.21),
        object_pose=pose(0, 0.1, 0.1, turn=straight),
        keypoints=np.array([[[0.1, 0, -0.1], [0.1, 0.02, -0.1]]]),
        surface_distance=np.array([[0.01, -1.0]]),
        surface_normal=np.array([[[1.0, 0, 0], [0, 0, 1.0]]]),
    )
    before = Readings(
        joints=0.2 * one,
        servo_targets=0.4 * one,
        palm_pose=pose(0, -0.02, 0.2),
        palm_set_point=pose(0, 0, 0.2),
        object_pose=now.object_pose,
        keypoints=now.keypoints,
        surface_distance=now.surface_distance,
        surface_normal=now.surface_normal,
    )
    goal = Wanted(
        palm_goal=pose(0, 0.05, 0.2),
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
    check(observe(*example()), EXPECTED)


def test_torch_sees_the_same():
    torch = pytest.importorskip("torch")
    now, before, goal, last = example()
    parts = observe(as_torch(now), as_torch(before), as_torch(goal), torch.as_tensor(last))
    assert all(isinstance(value, torch.Tensor) for value in parts.values())
    check(parts, EXPECTED)


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
    np.testing.assert_allclose(observe(now, before, goal, last)["phase"][0], expected)


def test_a_tilted_palm_knows_where_up_is():
    """Its x axis points up."""
    now, before, goal, last = example()
    now.palm_pose[0, 3:] = [HALF, 0, -HALF, 0]
    np.testing.assert_allclose(observe(now, before, goal, last)["up"][0], [1, 0, 0], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(-3.1, 3.1), x=st.floats(-2, 2), y=st.floats(-2, 2))
def test_where_the_table_stands_does_not_matter(seed, angle, x, y):
    """Everything moved and turned about the vertical."""
    hand, rng = load_hand("allegro"), np.random.default_rng(seed)
    now, before = readings(rng, hand, 3), readings(rng, hand, 3)
    goal, last = wanted(rng, hand, 3), action(rng, hand, 3)
    motion = np.array([x, y, 0.0, np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    here = observe(now, before, goal, last)
    there = observe(moved(now, motion), moved(before, motion), moved(goal, motion), last)
    for name in here:
        np.testing.assert_allclose(here[name], there[name], atol=1e-6, err_msg=name)


def test_height_and_tilt_matter(allegro):
    rng = np.random.default_rng(0)
    now, before = readings(rng, allegro, 2), readings(rng, allegro, 2)
    goal, last = wanted(rng, allegro, 2), action(rng, allegro, 2)
    here = observe(now, before, goal, last)

    def changed(motion: list[float]) -> set[str]:
        carried = [moved(values, np.array(motion)) for values in (now, before, goal)]
        there = observe(*carried, last)
        return {name for name in here if not np.allclose(here[name], there[name], atol=1e-9)}

    assert changed([0, 0, 0.1, 1, 0, 0, 0]) == {"palm_height"}
    assert changed([0, 0, 0, HALF, HALF, 0, 0]) == {"palm_height", "up"}


def test_contacts_that_a_teacher_sees():
    contacts = np.array([[True, False, True]])
    parts = privileged(contacts, np.array([[5.0, 0.0, 1e9]]), np.array([[True, True, False]]))
    check(
        parts,
        {"contacts": [1, 0, 1], "contact_errors": [0, 1, -1], "contact_forces": [np.tanh(1.0), 0, 1]},
    )
    guessed = privileged(np.array([[0.9, 0.2, 0.0]]), np.zeros((1, 3)), contacts)
    np.testing.assert_allclose(guessed["contact_errors"][0], [0.1, -0.2, 1.0])


def test_what_only_the_critic_sees():
    now = example()[0]
    seen = Sensed(
        contacts=np.ones((1, 2), bool),
        forces=np.zeros((1, 2)),
        object_velocity=np.array([[0.0, 0.2, 0.0, 0.0, 0.0, 4.0]]),
        table_forces=np.array([[0.0, 5.0]]),
        self_force=np.array([10.0]),
        object_on_table=np.array([True]),
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
    check(critic(seen, now, np.array([0.7]), np.array([0.3 / np.e])), expected)


@pytest.mark.parametrize("name", ["allegro", "inspire"])
def test_layouts_follow_the_hand(name):
    hand, rng = load_hand(name), np.random.default_rng(0)
    servos, points, links = len(hand.actuators), len(hand.keypoint_names), len(hand.links)
    now = readings(rng, hand, 2)
    parts = observe(now, readings(rng, hand, 2), wanted(rng, hand, 2), action(rng, hand, 2))
    sizes = dict(layout(parts))
    assert list(sizes) == list(EXPECTED)
    assert [sizes[key] for key in ("joints", "last_action")] == [servos, servos + 6]
    assert [sizes[key] for key in ("keypoint_errors", "surface_distances")] == [3 * points, points]
    assert [sizes[key] for key in ("target_normals", "target_distances")] == [3 * points, points]
    assert sizes["target_contacts"] == links
    assert flatten(parts).shape == (2, sum(sizes.values()))
    if name == "allegro":
        assert sum(sizes.values()) == 334
    truth = sensed(rng, hand, 2)
    contacts = privileged(truth.contacts, truth.forces, truth.contacts)
    assert layout(contacts) == (("contacts", links), ("contact_errors", links), ("contact_forces", links))
    more = critic(truth, now, np.ones(2), np.ones(2))
    assert flatten(more).shape == (2, 3 + 3 + links + 4)


def test_flattened_parts_keep_their_order(allegro):
    rng = np.random.default_rng(1)
    parts = observe(*example())
    flat, first = flatten(parts), 0
    for name, size in layout(parts):
        np.testing.assert_array_equal(flat[:, first : first + size], parts[name])
        first += size
    many = observe(
        readings(rng, allegro, 4), readings(rng, allegro, 4), wanted(rng, allegro, 4), action(rng, allegro, 4)
    )
    assert np.isfinite(flatten(many)).all()


def test_the_example_is_what_its_docstring_says():
    now, *_ = example()
    in_palm = compose(invert(now.palm_pose), now.object_pose)
    np.testing.assert_allclose(in_palm[0], [0.1, 0, -0.1, HALF, 0, 0, -HALF], atol=1e-12)
