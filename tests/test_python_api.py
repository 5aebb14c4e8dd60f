"""Mistakes in Python are answered as on the command line: in one line that names the thing and what to do."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retargeting import retarget
from fungrasp.training.training_sets import as_training_sets


@pytest.fixture(scope="module")
def human():
    return fungrasp.builtin_grasps()[:2]


def test_a_name_will_do_for_a_hand(human):
    objects = fungrasp.load_objects(human)
    robot = retarget(human, objects, "allegro")
    again = retarget(human, objects, fungrasp.load_hand("allegro"))
    np.testing.assert_array_equal(robot.joint_positions, again.joint_positions)
    by_name = fungrasp.static_quality(robot, human, objects, "allegro")
    alone = fungrasp.static_quality(robot)
    np.testing.assert_array_equal(alone.contact_gap_mm, by_name.contact_gap_mm)
    np.testing.assert_allclose(alone.place_error_mm, by_name.place_error_mm, atol=1.0)
    assert np.isnan(alone.link_direction_error_deg).all()
    with pytest.raises(FungraspError, match="no human contacts: give human="):
        fungrasp.static_quality(replace(robot, shown_places=None, shown_normals=None))
    assert fungrasp.build_scene("allegro", objects).hand.name == "allegro"
    assert fungrasp.MotionPlanner("allegro", objects).hand.name == "allegro"
    assert isinstance(fungrasp.make_planner("reference", "allegro", objects), fungrasp.MotionPlanner)
    assert isinstance(fungrasp.make_policy("student", "allegro", objects), fungrasp.Policy)
    for wrong, words in (
        (lambda: fungrasp.make_policy("student", None, objects), "expected a hand, .* not NoneType"),  # type: ignore[arg-type]
        (lambda: fungrasp.LiftEnvironment("allegro", 2), r"expected a scene \(.*build_scene.* not a str"),  # type: ignore[arg-type]
        (lambda: fungrasp.build_scene("allegro", "can"), "expected objects by name, .* not str"),  # type: ignore[arg-type]
        (lambda: fungrasp.Retargeter("allegro", "can"), "model must be an object .* not a str"),  # type: ignore[arg-type]
    ):
        with pytest.raises(FungraspError, match=words):
            wrong()


def test_an_environment_takes_one_grasp_and_one_plan_per_world(human):
    robot, objects = retarget(human), fungrasp.load_objects(human)
    environment = fungrasp.LiftEnvironment(fungrasp.build_scene("allegro", objects), 2)
    with pytest.raises(FungraspError, match="1 robot grasps for an environment of 2 worlds"):
        environment.settle(robot[:1])
    plans = fungrasp.MotionPlanner("allegro", objects).plan(robot, environment.settle(robot))
    for wrong, words in (
        (plans[0], "1 plans for an environment of 2"),
        (robot, "plans, not a RobotGraspSet"),
    ):
        with pytest.raises(FungraspError, match=words):
            fungrasp.play(environment, OpenLoopPolicy(), wrong)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("hand", "message"),
    [
        ("alegro", "Did you mean 'allegro'"),
        ("my.urdf", "'fungrasp hands add my.urdf' makes a hand"),
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
    for verb in (retarget, fungrasp.plan, fungrasp.evaluate):
        for other in ("shadow", fungrasp.load_hand("shadow")):
            with pytest.raises(FungraspError, match="'shadow' is a hand: give hand='shadow'"):
                verb(human, other)  # type: ignore[arg-type]
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
    for verb in (retarget, fungrasp.plan, fungrasp.evaluate, fungrasp.deploy, fungrasp.load_objects):
        for wrong, words in (
            ({"hand_joints": 0}, "dict: fungrasp.human_grasp"),
            ("mug", "str: fungrasp.load_grasps"),
            ([human[0]], "list: HumanGraspSet.of"),
        ):
            with pytest.raises(FungraspError, match=f"expected human or robot grasps, not a {words}"):
                verb(wrong)  # type: ignore[arg-type]
    for kind, save, other in (
        (fungrasp.HumanGraspSet, fungrasp.save_human_grasps, robot),
        (fungrasp.RobotGraspSet, fungrasp.save_robot_grasps, human),
    ):
        for wrong in (other, "g.npz", [human[0]]):
            with pytest.raises(FungraspError, match=f"expected a path, then a {kind.__name__}, not a"):
                save("g.npz", wrong)
        with pytest.raises(FungraspError, match=f"{kind.__name__}.of makes a set of single grasps"):
            kind.of([other[0]])
    plans = fungrasp.plan(robot)
    for wrong, words in (
        (robot, "expected the plans .* not a RobotGraspSet"),
        (plans.select(np.array([0])), "1 plans for 2 grasps"),
        (replace(plans, hand="leap"), "of the hand 'leap'"),
        (replace(plans, object_name=np.array(["mug", "can"])), "row 1: the plan is for the object 'can'"),
    ):
        with pytest.raises(FungraspError, match=words):
            GivenPlans(wrong, robot)  # type: ignore[arg-type]


WITHOUT_EXTRAS = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "rsl_rl", "tensorboard", "mink", "mcap", "viser", "onnx"):
            raise ModuleNotFoundError(f"No module named '{name}'")

sys.meta_path.insert(0, Missing())
from fungrasp import *

try:
    train("runs", builtin_grasps())
except FungraspError as error:
    print(error)
"""


def test_all_names_are_there_without_extras():
    done = subprocess.run([sys.executable, "-c", WITHOUT_EXTRAS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "training needs more packages (No module named 'torch')" in done.stdout
    assert "[learning]" in done.stdout


def test_train_takes_grasps_of_its_hand_or_of_a_person(human, tmp_path):
    (one,) = as_training_sets(human[0], fungrasp.load_hand("allegro"))
    assert one.grasps.hand == "allegro" and list(one.objects) == ["mug"]
    robot = retarget(human, hand="leap")
    for sets, words in (
        (robot, "grasps: the grasps are of the hand 'leap', not of 'allegro'"),
        ([fungrasp.TrainingSet("mine", robot, {})], "mine: the grasps are of the hand 'leap'"),
        ([3], "expected human or robot grasps, not a int"),
    ):
        with pytest.raises(FungraspError, match=words):
            fungrasp.train(tmp_path / "t", sets)  # pyright: ignore[reportArgumentType]
    assert not (tmp_path / "t").exists()


def test_evaluate_takes_plans_and_planners_only(human):
    robot = fungrasp.retarget(human, hand="allegro")
    with pytest.raises(FungraspError, match="expected a LiftTestSpec, not 'reality'"):
        fungrasp.evaluate(robot, spec="reality")  # pyright: ignore[reportArgumentType]
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
    for obj in (human, human[0], retarget(human), objects["mug"], fungrasp.load_hand("allegro")):
        assert len(repr(obj)) < 100


def test_type_checkers_are_told_the_names_that_are_loaded_on_use():
    stub = Path(fungrasp.__file__).with_suffix(".pyi").read_text()
    told = re.findall(r"^from fungrasp\.(\S+) import (\w+) as \2$", stub, re.MULTILINE)
    offered = {name: module for module, names in fungrasp._NAMES.items() for name in names.split()}  # pyright: ignore[reportAttributeAccessIssue]
    assert {name: module for module, name in told} == offered
