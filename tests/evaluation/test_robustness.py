"""What disturbances do to worlds and to what a policy believes."""

from __future__ import annotations

import numpy as np
import pytest
from lifted_grasps import allegro_hand, good_grasps, grasped_objects

from fungrasp.errors import FungraspError
from fungrasp.evaluation import Disturbance, evaluate
from fungrasp.geometry.poses import compose, invert, rotation_vector, transform_points
from fungrasp.simulation import build_scene
from fungrasp.task import LiftTask


@pytest.fixture(scope="module")
def allegro():
    return allegro_hand()


@pytest.fixture(scope="module")
def things():
    return grasped_objects()


@pytest.fixture(scope="module")
def good():
    return good_grasps()


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
    seen = disturbance.seen_by_policy(task, centers, 0, rows)
    error = compose(invert(task.settled_pose), seen.settled_pose)
    np.testing.assert_allclose(np.linalg.norm(rotation_vector(error[:, 3:]), axis=1), np.deg2rad(10))
    true = transform_points(task.settled_pose, centers[:, None])
    believed = transform_points(seen.settled_pose, centers[:, None])
    np.testing.assert_allclose(np.linalg.norm(believed - true, axis=-1), 0.01, atol=1e-9)
    np.testing.assert_allclose(seen.target_pose, compose(seen.settled_pose, task.wrist_in_object))
    assert seen.time == task.time and seen.protocol is task.protocol


def test_noise_depends_on_seed_and_row_alone(scene, good, things):
    disturbance = Disturbance(position_noise=0.01)
    task = reset(scene, good, disturbance)
    centers = np.zeros((4, 3))
    one = disturbance.seen_by_policy(task, centers, 0, np.array([0, 1, 2, 3])).settled_pose
    again = disturbance.seen_by_policy(task, centers, 0, np.array([0, 1, 2, 3])).settled_pose
    other = disturbance.seen_by_policy(task, centers, 1, np.array([0, 1, 2, 3])).settled_pose
    shifted = disturbance.seen_by_policy(task, centers, 0, np.array([9, 1, 8, 7])).settled_pose
    np.testing.assert_array_equal(one, again)
    assert (np.abs(one - other).max(axis=1) > 1e-4).all()
    np.testing.assert_array_equal(one[1], shifted[1])
    assert np.abs(one[0] - shifted[0]).max() > 1e-4


def test_without_noise_the_policy_sees_the_task_itself(scene, good):
    disturbance = Disturbance(mass_scale=2.0)
    task = reset(scene, good, disturbance)
    assert disturbance.seen_by_policy(task, np.zeros((4, 3)), 0, np.arange(4)) is task
    assert not disturbance.is_random


def test_a_policy_that_is_5_cm_wrong_about_the_object_fails(good, things, allegro):
    result = evaluate(
        good.select([0, 2]), things, allegro, disturbance=Disturbance(position_noise=0.08), seeds=(3,)
    )
    assert not result.trials.success.all()
