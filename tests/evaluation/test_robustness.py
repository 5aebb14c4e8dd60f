"""What disturbances do to worlds and to what a policy believes."""

from __future__ import annotations

from dataclasses import asdict, fields

import numpy as np
import pytest
from fungrasp.evaluation.robustness import PUSHES

from fungrasp.errors import FungraspError
from fungrasp.evaluation import CONDITIONS, Disturbance, evaluate
from fungrasp.geometry.poses import compose, invert, rotation_vector, transform_points
from fungrasp.simulation import build_scene
from fungrasp.task import LiftTask


@pytest.fixture(scope="module")
def scene(things, allegro):
    return build_scene(allegro, things)


def reset(scene, grasps, disturbance: Disturbance) -> LiftTask:
    task = LiftTask(scene, disturbance.placed(grasps), disturbance.worlds(scene, grasps, threads=1))
    task.reset()
    return task


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mass_scale": 0.0}, "mass scale must be positive"),
        ({"mass_scale": np.nan}, "mass scale must be positive"),
        ({"friction": -1.0}, "friction must be positive"),
        ({"position_noise": -0.1}, "position noise must be finite and not negative"),
        ({"rotation_noise": np.inf}, "rotation noise must be finite"),
        ({"table_height": 3.0}, "table height must be within 0.2 m"),
        ({"latency": 0.11}, "latency must be 0 to 0.1 s"),
        ({"latency": np.nan}, "latency must be 0 to 0.1 s"),
        ({"push": -1.0}, "push must be finite and not negative"),
        ({"push_duration": 0.0}, "push duration must be positive"),
        ({"object_shift": np.inf}, "object shift must be finite"),
    ],
)
def test_disturbances_that_cannot_be(values, words):
    with pytest.raises(FungraspError, match=words):
        Disturbance(**values)


def test_the_worlds_have_the_true_mass_and_friction(scene, good):
    worlds = Disturbance(mass_scale=2.0, friction=0.6).worlds(scene, good, threads=1)
    body = scene.model.body("object").id
    np.testing.assert_allclose(worlds.batch.expand("body_mass")[:, body], 2.0 * good.object_mass)
    assert (worlds.batch.expand("geom_friction")[:, :, 0] == 0.6).all()


def test_a_higher_table_carries_the_objects_higher(scene, good):
    usual, raised = (reset(scene, good, Disturbance(table_height=height)) for height in (0.0, 0.02))
    rise = raised.settled_pose[:, 2] - usual.settled_pose[:, 2]
    np.testing.assert_allclose(rise, 0.02, atol=1e-4)
    np.testing.assert_allclose(raised.target_pose[:, 2] - usual.target_pose[:, 2], 0.02, atol=1e-3)
    assert raised.worlds.object_on_table.all()


def test_pose_noise_has_the_given_size_about_the_centre_of_mass(scene, good, things):
    disturbance = Disturbance(position_noise=0.01, rotation_noise=np.deg2rad(10))
    task = reset(scene, good, disturbance)
    centers = np.array([things[name].center_of_mass for name in good.object_name])
    rows = np.array([0, 1, 2, 3])
    seen = disturbance.disturb(task, centers, 0, rows)
    error = compose(invert(task.settled_pose), seen.settled_pose)
    np.testing.assert_allclose(np.linalg.norm(rotation_vector(error[:, 3:]), axis=1), np.deg2rad(10))
    true = transform_points(task.settled_pose, centers[:, None])
    believed = transform_points(seen.settled_pose, centers[:, None])
    np.testing.assert_allclose(np.linalg.norm(believed - true, axis=-1), 0.01, atol=1e-9)
    np.testing.assert_allclose(seen.target_pose, compose(seen.settled_pose, task.wrist_in_object))
    assert seen.time is task.time and seen.protocol is task.protocol
    tracked = transform_points(seen.tracked_object_pose, centers[:, None])
    np.testing.assert_allclose(tracked, believed, atol=1e-9)


@pytest.mark.parametrize("what", ["position_noise", "object_shift"])
def test_what_is_drawn_depends_on_seed_and_row_alone(scene, good, what):
    disturbance = Disturbance(**{what: 0.01})

    def place(seed: int, rows: list[int]) -> np.ndarray:
        """Of the objects, as seen against where they are."""
        task = reset(scene, good, disturbance)
        seen = disturbance.disturb(task, np.zeros((4, 3)), seed, np.array(rows))
        return seen.settled_pose - task.settled_pose

    one, again, other = place(0, [0, 1, 2, 3]), place(0, [0, 1, 2, 3]), place(1, [0, 1, 2, 3])
    shifted = place(0, [9, 1, 8, 7])
    np.testing.assert_array_equal(one, again)
    assert (np.abs(one - other).max(axis=1) > 1e-4).all()
    np.testing.assert_array_equal(one[1], shifted[1])
    assert np.abs(one[0] - shifted[0]).max() > 1e-4


def test_without_noise_the_policy_sees_the_task_itself(scene, good):
    disturbance = Disturbance(mass_scale=2.0, latency=0.06)
    task = reset(scene, good, disturbance)
    assert disturbance.disturb(task, np.zeros((4, 3)), 0, np.arange(4)) is task
    assert not disturbance.is_random
    assert task.latency.tolist() == [0.06] * 4


def test_a_hidden_shift_moves_the_object_and_not_the_plan(scene, good):
    disturbance = Disturbance(object_shift=0.02)
    task, usual = (reset(scene, good, d) for d in (disturbance, Disturbance()))
    seen = disturbance.disturb(task, np.zeros((4, 3)), 5, np.arange(4))
    shift = task.settled_pose - usual.settled_pose
    np.testing.assert_allclose(np.linalg.norm(shift[:, :2], axis=1), 0.02)
    np.testing.assert_allclose(shift[:, 2:], 0.0, atol=1e-12)
    assert np.linalg.norm(np.diff(shift[:, :2], axis=0), axis=1).min() > 1e-3, "directions differ"
    np.testing.assert_allclose(task.worlds.object_pose, task.settled_pose)
    np.testing.assert_allclose(task.settled_height, usual.settled_height, atol=1e-9)
    np.testing.assert_array_equal(seen.settled_pose, usual.settled_pose)
    np.testing.assert_allclose(seen.target_pose, usual.target_pose, atol=1e-12)
    np.testing.assert_allclose(seen.tracked_object_pose, task.settled_pose, atol=1e-12)
    np.testing.assert_allclose(task.worlds.palm_pose, usual.worlds.palm_pose, atol=1e-6)
    for one in (task, usual):
        one.worlds.step(100)
    np.testing.assert_allclose(task.worlds.object_pose - usual.worlds.object_pose, shift, atol=1e-3)
    assert task.worlds.object_on_table.all()


def test_pushes_are_forces_at_their_times_of_the_hold(scene, good):
    disturbance = Disturbance(mass_scale=2.0, push=1.5, push_duration=0.1)
    task = reset(scene, good, disturbance)
    push = disturbance.pusher(task, 0, np.arange(4))
    body = scene.model.body("object").id
    applied = task.worlds.batch.bind("xfrc_applied")

    def at(since_hold: float) -> np.ndarray:
        task.hold_time[:] = [0.0, 0.0, 0.0, np.inf]
        task.time[:] = since_hold
        push()
        return applied[:, body].copy()

    for quiet in (0.0, 0.48, 0.6, 1.0, 2.9):
        assert not at(quiet).any()
    forces = np.stack([at(start + 0.04) for start in PUSHES])
    weights = 2.0 * 9.81 * good.object_mass
    np.testing.assert_allclose(np.linalg.norm(forces[:, :3, :3], axis=-1), np.tile(1.5 * weights[:3], (3, 1)))
    assert not forces[:, 3].any() and not forces[..., 3:].any(), "the hold of the last has not begun"
    directions = (forces[:, :3, :3] / weights[:3, None]).reshape(9, 3)
    assert np.linalg.norm(directions[:, None] - directions, axis=-1)[~np.eye(9, dtype=bool)].min() > 0.01
    np.testing.assert_array_equal(at(PUSHES[1] + 0.02), at(PUSHES[1] + 0.08))


def test_a_push_moves_what_is_held(good, things, allegro):
    """A little in the hand when it is as strong as the weight; out of the hand when it is 60 times that."""
    some = good.select([0, 2])
    still, pushed, hit = (
        evaluate(some, things, allegro, disturbance=Disturbance(push=push)).trials for push in (0, 1, 60)
    )
    assert still.success.all() and pushed.success.all() and not hit.success.any()
    assert (pushed.sim_distance_hand_mm_s > 1.2 * still.sim_distance_hand_mm_s).all()
    np.testing.assert_array_equal(pushed.pushed_m, still.pushed_m)
    assert set(hit.reason) <= {"dropped during the hold", "the object touched the table during the hold"}


def test_a_policy_that_does_not_look_misses_an_object_that_was_moved(good, things, allegro):
    some = good.select([0, 2])
    trials = evaluate(some, things, allegro, disturbance=Disturbance(object_shift=0.1)).trials
    assert not trials.success.any()


def test_late_actions_still_lift(good, things, allegro):
    some = good.select([0, 2])
    assert evaluate(some, things, allegro, disturbance=Disturbance(latency=0.1)).trials.success.all()


def test_the_protocol_has_every_kind_of_disturbance_once_and_nothing_first():
    assert next(iter(CONDITIONS.values())) == Disturbance()
    assert len(CONDITIONS) == len(set(CONDITIONS.values())) == 11
    changed = [
        name
        for disturbance in CONDITIONS.values()
        for name, value in asdict(disturbance).items()
        if value != getattr(Disturbance(), name)
    ]
    kinds = {field.name for field in fields(Disturbance)} - {"push_duration"}
    assert set(changed) == kinds and len(changed) == 11, "one kind each, but position and rotation together"


def test_a_policy_that_is_5_cm_wrong_about_the_object_fails(good, things, allegro):
    result = evaluate(
        good.select([0, 2]), things, allegro, disturbance=Disturbance(position_noise=0.08), seeds=(3,)
    )
    assert not result.trials.success.all()
