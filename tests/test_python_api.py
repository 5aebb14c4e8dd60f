"""Mistakes in Python are answered as on the command line: in one line that names the thing and what to do."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.retargeting import retarget


@pytest.fixture(scope="module")
def human():
    return fungrasp.builtin_grasps()[:2]


def test_a_name_will_do_for_a_hand(human):
    objects = fungrasp.load_objects(human)
    robot = retarget(human, objects, "allegro")
    again = retarget(human, objects, fungrasp.load_hand("allegro"))
    np.testing.assert_array_equal(robot.joint_positions, again.joint_positions)
    by_name = fungrasp.static_quality(robot, human, objects, "allegro")
    assert len(by_name.contact_error_mm) == 2
    assert fungrasp.build_scene("allegro", objects).hand.name == "allegro"
    assert fungrasp.MotionPlanner("allegro", objects).hand.name == "allegro"


@pytest.mark.parametrize(
    ("hand", "message"),
    [
        ("alegro", "Did you mean 'allegro'"),
        (None, "expected a hand, .* not NoneType"),
        (3, "expected a hand"),
    ],
)
def test_what_is_no_hand_is_said(human, hand, message):
    with pytest.raises(FungraspError, match=message):
        retarget(human, fungrasp.load_objects(human), hand)


def test_missing_objects_and_wrong_kinds_are_named(human):
    objects = fungrasp.load_objects(human)
    with pytest.raises(FungraspError, match=r"the object 'mug' .* given: none"):
        retarget(human, {}, "allegro")
    with pytest.raises(FungraspError, match=r"expected objects .* not a str"):
        retarget(human, {"mug": "mug"}, "allegro")  # type: ignore[arg-type]
    with pytest.raises(FungraspError, match=r"the object 'mug' of the grasps is not given; given: can"):
        retarget(human, fungrasp.load_object("can"), "allegro")
    unknown = replace(human, object_name=np.array(["my mug"] * len(human)))
    with pytest.raises(FungraspError, match=r"unknown object 'my mug'.*object_from_mesh"):
        retarget(unknown)
    with pytest.raises(FungraspError, match="the set is empty"):
        retarget(human[:0], objects, "allegro")
    robot = retarget(human, objects, "allegro")
    with pytest.raises(FungraspError, match=r"only human grasps .* not a RobotGraspSet"):
        retarget(robot, objects, "allegro")
    for verb in (retarget, fungrasp.plan, fungrasp.evaluate, fungrasp.deploy):
        with pytest.raises(FungraspError, match="expected human or robot grasps, not a dict"):
            verb({"hand_joints": 0})  # type: ignore[arg-type]
    plans = fungrasp.plan(robot)
    for wrong, words in (
        (robot, "expected the plans .* not a RobotGraspSet"),
        (plans.select(np.array([0])), "1 plans for 2 grasps"),
        (replace(plans, hand="leap"), "of the hand 'leap'"),
        (replace(plans, object_name=np.array(["mug", "can"])), "row 1: the plan is for the object 'can'"),
    ):
        with pytest.raises(FungraspError, match=words):
            GivenPlans(wrong, robot)  # type: ignore[arg-type]


def test_evaluate_takes_plans_and_planners_only(human):
    robot = fungrasp.retarget(human, hand="allegro")
    for wrong in (robot, "plan"):
        with pytest.raises(fungrasp.FungraspError, match=r"plans= takes plans .* not a (RobotGraspSet|str)"):
            fungrasp.evaluate(robot, plans=wrong)  # pyright: ignore[reportArgumentType]


def test_what_one_verb_returns_the_next_one_takes():
    """Neither objects nor hand are given again."""
    human = fungrasp.builtin_grasps()[[36, 52]]
    robot = retarget(human[0])
    assert isinstance(robot, fungrasp.RobotGrasp)
    whole = retarget(human)
    np.testing.assert_array_equal(robot.joint_positions, whole.joint_positions[0])
    plans = fungrasp.plan(robot)
    slow = replace(plans, palm_goal_object=plans.palm_goal_object[:, :1])
    for given, held in ((plans, True), (slow, False)):
        result = fungrasp.evaluate(robot, plans=given)
        assert result.success.tolist() == [held], result.outcomes.reason
    own = fungrasp.evaluate(human[0])
    np.testing.assert_array_equal(own.outcomes.pushed_m, fungrasp.evaluate(robot).outcomes.pushed_m)


def test_a_given_plan_is_deployed(human):
    robot = retarget(fungrasp.builtin_grasps()[52])
    plans = fungrasp.plan(robot)
    spec = fungrasp.DeploymentSpec(policy="reference", until="lift")
    seen = []

    class Watch(fungrasp.DeploymentObserver):
        def planned(self, robot, prepared):
            seen.append(prepared.plan)

    fungrasp.deploy(robot, plans=plans, spec=spec, observer=Watch())
    np.testing.assert_array_equal(seen[0].palm_goal_object, plans.palm_goal_object)
    assert np.abs(seen[0].object_pose - plans.object_pose).max() > 1e-4
    with pytest.raises(FungraspError, match=r"one grasp is deployed at a time, not 2"):
        fungrasp.deploy(human)


def test_reprs_are_short(human):
    objects = fungrasp.load_objects(human)
    for obj in (human, human[0], objects["mug"], fungrasp.load_hand("allegro")):
        assert len(repr(obj)) < 100


def test_type_checkers_are_told_the_names_that_are_loaded_on_use():
    stub = Path(fungrasp.__file__).with_suffix(".pyi").read_text()
    told = re.findall(r"^from fungrasp\.(\S+) import (\w+) as \2$", stub, re.MULTILINE)
    offered = {name: module for module, names in fungrasp._NAMES.items() for name in names.split()}  # pyright: ignore[reportAttributeAccessIssue]
    assert {name: module for module, name in told} == offered
