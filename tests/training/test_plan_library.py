"""Plans to train on: variations that are usable, kept in a file."""

from __future__ import annotations

import numpy as np
import pytest
from small_training import hand, library, training_set

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.retargeting import retarget
from fungrasp.training.settings import TrainSpec, Variety
from fungrasp.training.training_sets import build_plan_library, kept_library

ONE = TrainSpec(threads=1, variety=Variety(copies=1))
HELD = TrainSpec(threads=1, variety=Variety(copies=1, held=True))


def test_a_library_survives_a_file(tmp_path):
    path = tmp_path / "plans.npz"
    kept_library(path, "key", library)
    found = kept_library(path, "key", lambda: pytest.fail("planned again"))
    np.testing.assert_array_equal(found.group, library().group)
    assert found.plans.arrays().keys() == library().plans.arrays().keys()
    for name, value in library().plans.arrays().items():
        np.testing.assert_array_equal(found.plans.arrays()[name], value, err_msg=name)


def test_what_is_of_another_library_or_damaged_is_planned_again(tmp_path):
    path, again = tmp_path / "plans.npz", []
    kept_library(path, "key", library)
    kept_library(path, "another key", lambda: again.append("key") or library())
    path.write_bytes(path.read_bytes()[:1000])
    kept_library(path, "another key", lambda: again.append("damaged") or library())
    with np.load(path) as data:
        arrays = dict(data)
    del arrays["palm_goal_object"]
    np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]
    kept_library(path, "another key", lambda: again.append("a field is missing") or library())
    assert again == ["key", "damaged", "a field is missing"]


def test_every_grasp_has_its_copies_and_the_first_is_the_grasp_itself():
    one, plans = training_set(), library().plans
    assert library().group.tolist() == [0, 0, 1, 1]
    assert plans.object_name.tolist() == np.repeat(one.grasps.object_name, 2).tolist()
    single = build_plan_library(one.grasps, one.objects, hand(), ONE).plans
    length = single.palm_goal_object.shape[1]
    np.testing.assert_allclose(single.palm_goal_object, plans.palm_goal_object[::2, :length], atol=1e-6)
    assert (np.abs(plans.grasp_joints[::2] - plans.grasp_joints[1::2]).max(axis=1) > 0.01).all()


def test_no_copies_are_refused():
    with pytest.raises(FungraspError, match="at least one copy"):
        Variety(copies=0)


def test_plans_that_do_not_hold_as_shown_can_be_left_out():
    human = builtin_grasps().select(np.array([54, 54]))
    objects = load_objects(human)
    grasps = retarget(human, objects, hand(), threads=1)
    grasps.wrist_pose[1, :3] += 0.3
    every = build_plan_library(grasps, objects, hand(), ONE)
    held = build_plan_library(grasps, objects, hand(), HELD)
    assert every.group.tolist() == [0, 1] and held.group.tolist() == [0]
    with pytest.raises(FungraspError, match="holds its object as shown"):
        build_plan_library(grasps.select(np.array([1])), objects, hand(), HELD)
