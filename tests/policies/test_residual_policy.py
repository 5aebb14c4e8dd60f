"""Policies from files at work: what their network says is what is done, and what does not fit is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from onnx import helper
from planned_grasps import grasps_and_objects, layouts, motion, start, tracker
from small_policies import allegro_card, model

from fungrasp.errors import FungraspError
from fungrasp.policies import ReferenceController, make_policy
from fungrasp.policies import residual_policy as learned
from fungrasp.policies.checkpoint.card import ActionPart, Part
from fungrasp.policies.checkpoint.checkpoint_file import load_policy, save_policy
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.policies.residual_policy import LearnedPolicy, residual_settings

ACTION = (ActionPart("position", 3, 0.02), ActionPart("rotation", 3, 0.1), ActionPart("fingers", 16, 0.2))
SIZE = 22
SETTINGS = ResidualSettings(position=0.02, rotation=0.1, fingers=0.2, smoothing=0.5)


@pytest.fixture(autouse=True)
def planned_before(monkeypatch):
    """The same motion for all, planned once."""
    monkeypatch.setattr(learned, "planned", lambda task, objects: motion())


def policy_file(
    folder: Path, offset: np.ndarray | None = None, watch: tuple[str, float] | None = None, **card
) -> Path:
    """A policy with the action ``offset``; its first number follows the first of a part of the observation.

    Args:
        folder: for the file.
        offset: shape [A], zero if None.
        watch: name of that part and gain.
        card: fields that differ.
    """
    seen, contacts = layouts()
    kind = card.get("kind", "student")
    values = {
        "kind": kind,
        "observation": tuple(Part(*part) for part in seen),
        "privileged": tuple(Part(*part) for part in contacts) if kind == "teacher" else (),
        "action": ACTION,
        "action_smoothing": 0.5,
    }
    described = allegro_card(**(values | card))
    matrix = np.zeros((described.input_size, described.action_size), np.float32)
    if watch is not None:
        names = [part.name for part in described.inputs]
        at = names.index(watch[0])
        matrix[sum(part.size for part in described.inputs[:at]), 0] = watch[1]
    constant = np.zeros(described.action_size) if offset is None else offset
    graph = model(
        [helper.make_node("Gemm", ["observation", "matrix", "offset"], ["action"])],
        {"observation": ["worlds", described.input_size]},
        {"action": ["worlds", described.action_size]},
        {"matrix": matrix, "offset": constant.astype(np.float32)},
    )
    path = folder / "p.onnx"
    save_policy(path, graph, described)
    return path


def at_work(path: Path, task) -> LearnedPolicy:
    policy = make_policy(str(path), task, grasps_and_objects()[1])
    assert isinstance(policy, LearnedPolicy)
    return policy


def keep_in_place(task) -> None:
    """Put the objects back: they are touched on the hand's way, and a policy follows them."""
    task.worlds.object_pose = task.settled_pose
    task.worlds.qvel[:, :6] = 0.0
    task.worlds.forward()


@pytest.mark.parametrize("kind", ["student", "teacher"])
def test_a_policy_that_changes_nothing_is_the_reference_controller(tmp_path, kind):
    task, other = start(), start()
    policy = at_work(policy_file(tmp_path, kind=kind), task)
    reference = ReferenceController(other, grasps_and_objects()[1])
    while not (task.time >= 0.1 * (motion().lift.max() + 2)).all():
        for one in (task, other):
            keep_in_place(one)
        ours, theirs = policy.act(), reference.act()
        np.testing.assert_allclose(ours.wrist_pose, theirs.wrist_pose, atol=1e-9)
        np.testing.assert_array_equal(ours.finger_targets, theirs.finger_targets)
        np.testing.assert_array_equal(ours.lift, theirs.lift)
        task.step(ours)
        other.step(theirs)
    np.testing.assert_array_equal(task.lift_time, other.lift_time)
    assert np.isfinite(task.lift_time).all()


def test_a_networks_actions_are_residuals_of_the_cards_size(tmp_path):
    offset = np.linspace(-1.5, 1.5, SIZE)
    task, other = start(), start()
    policy = at_work(policy_file(tmp_path, offset), task)
    follower = tracker(other, settings=SETTINGS)
    for step in range(3):
        if step:
            follower.advance()
        ours, theirs = policy.act(), follower.act(np.tile(offset, (2, 1)))
        np.testing.assert_allclose(ours.wrist_pose, theirs.wrist_pose, atol=1e-7)
        np.testing.assert_allclose(ours.finger_targets, theirs.finger_targets, atol=1e-7)
        task.step(ours)
        other.step(theirs)


def test_it_sees_what_happens_to_the_object_of_its_world(tmp_path):
    path = policy_file(tmp_path, watch=("object_deviation", 0.1))
    task, moved = start(), start()
    pose = moved.worlds.object_pose
    pose[1, :3] += [0.02, 0.02, 0.01]
    moved.worlds.object_pose = pose
    moved.worlds.forward()
    actions = []
    for one in (task, moved):
        policy = at_work(path, one)
        policy.act()
        actions.append(policy._tracker.action)
    np.testing.assert_array_equal(actions[0][0], actions[1][0])
    assert abs(actions[0][1, 0] - actions[1][1, 0]) > 0.01


def test_a_teacher_sees_contacts(tmp_path):
    """As the first of them: whether the palm touches."""
    policy = at_work(policy_file(tmp_path, watch=("contact_errors", 1.0), kind="teacher"), start())
    policy.act()
    wanted = grasps_and_objects()[0].link_contacts[:, 0]
    np.testing.assert_allclose(policy._tracker.action[:, 0], 0.5 * wanted)


def test_a_broken_world_does_not_stop_the_others(tmp_path):
    path = policy_file(tmp_path, watch=("object_deviation", 0.1))
    task, other = start(), start()
    broken, whole = at_work(path, task), at_work(path, other)
    for step in range(2):
        if step:
            task.worlds.qpos[1] = np.nan
        ours, theirs = broken.act(), whole.act()
        np.testing.assert_array_equal(ours.wrist_pose[0], theirs.wrist_pose[0])
        np.testing.assert_array_equal(ours.finger_targets[0], theirs.finger_targets[0])


def reordered(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    return parts[1:] + parts[:1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hand": "leap"}, "made for the hand 'leap', not 'allegro'"),
        ({"hand_digest": "0" * 64}, "model of the hand 'allegro' has changed"),
        ({"rate_hz": 20.0}, "acts at 20 Hz, here at 10 Hz"),
        (
            {"action": (ActionPart("wrist", 6, 0.1), ActionPart("fingers", 16, 0.2))},
            "has the actions wrist, fin",
        ),
    ],
)
def test_policies_made_for_something_else_are_refused(change, words, tmp_path):
    path = policy_file(tmp_path, **change)
    with pytest.raises(FungraspError, match=words):
        make_policy(str(path), start(), grasps_and_objects()[1])


def test_nothing_is_planned_for_a_policy_of_another_hand(tmp_path, monkeypatch):
    monkeypatch.setattr(learned, "planned", lambda task, objects: pytest.fail("planned"))
    path = policy_file(tmp_path, hand="leap")
    with pytest.raises(FungraspError, match="made for the hand 'leap'"):
        make_policy(str(path), start(), grasps_and_objects()[1])


def test_other_observations_are_refused(tmp_path):
    seen = tuple(Part(*part) for part in layouts()[0])
    contacts = tuple(Part(*part) for part in layouts()[1])
    wider = (*seen[:-1], Part(seen[-1].name, seen[-1].size + 1))
    for changes, words in (
        ({"observation": reordered(seen)}, "observation is in the order"),
        ({"observation": wider}, f"'last_action' of its observation has {SIZE + 1} numbers, here {SIZE}"),
        ({"observation": seen[1:]}, "observation lacks 'joints'"),
        ({"kind": "teacher", "privileged": contacts[:2]}, "privileged observation lacks 'contact_forces'"),
    ):
        with pytest.raises(FungraspError, match=words):
            make_policy(str(policy_file(tmp_path, **changes)), start(), grasps_and_objects()[1])


def test_the_card_says_how_far_actions_go(tmp_path):
    assert residual_settings(load_policy(policy_file(tmp_path)).card) == SETTINGS
