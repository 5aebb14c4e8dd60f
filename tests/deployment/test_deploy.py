"""``deploy``, the one entry: on a twin, where its grasp comes from, and what it refuses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from robot_cells import Told

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.deployment.log import read_log
from fungrasp.deployment.spec import DeploymentSpec, GraspChoice, why_not_tried
from fungrasp.grasps import HumanGraspSet, builtin_grasps
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object

FAST = DeploymentSpec(policy="reference", until="lift")


@pytest.fixture(scope="module")
def human():
    grasps = fungrasp.builtin_grasps()
    return grasps[grasps.object_name == "wine_glass"][:2]


@pytest.fixture(scope="module")
def objects(human):
    return fungrasp.load_objects(human)


@pytest.fixture(scope="module")
def robot(human, objects):
    return fungrasp.retarget(human, objects, "allegro")


def test_a_grasp_is_deployed_on_a_twin_and_logged(robot, objects, tmp_path):
    phases: list[str] = []
    result = fungrasp.deploy(
        robot[:1], objects, spec=FAST, log=tmp_path / "lift.mcap", observer=Told(phases.append)
    )
    assert result.phase == "done" and result.spec == FAST
    assert phases[:3] == ["move to start", "grasp", "lift"]
    assert result.words().startswith("lifted and held at" if result.success else "not lifted")
    assert result.as_shown is not None and len(result.as_shown) == 1
    assert ("as shown" in result.words()) == result.success
    log = read_log(tmp_path / "lift.mcap")
    assert log.complete and log.about["policy"] == "reference" and log.about["robot"] == "ur5e-allegro"


def test_words_take_the_place_of_those_of_the_specification(robot, objects):
    with pytest.raises(FungraspError, match="Did you mean 'ur5e-allegro'"):
        fungrasp.deploy(robot[:1], objects, "ur5e-alegro", spec=FAST)
    with pytest.raises(FungraspError, match="Did you mean 'reference'"):
        fungrasp.deploy(robot[:1], objects, policy="referenc", spec=FAST)


def test_what_can_not_be_deployed_is_said_before_anything_moves(human, robot, objects):
    with pytest.raises(FungraspError, match=r"one grasp .* not 2: select one, as in robot\[0\]"):
        fungrasp.deploy(robot, objects, spec=FAST)
    other = fungrasp.retarget(human[:1], objects, "inspire")
    with pytest.raises(FungraspError, match="carries the hand 'allegro', and the grasp is of 'inspire'"):
        fungrasp.deploy(other, objects, spec=FAST)
    with pytest.raises(FungraspError, match="open-loop policy"):
        fungrasp.deploy(robot[:1], objects, spec=DeploymentSpec(policy="reference", attempts=2))


def test_a_specification_travels_as_json():
    assert record_from_json(DeploymentSpec, record_to_json(FAST), "spec") == FAST


ACCEPTANCE = SimpleNamespace(summary=lambda: "not sure: 40 %")


def seen(name: str, confident: bool, *warnings: str) -> Any:
    """What is seen of the mug."""
    grasp = SimpleNamespace(object_name=name)
    model = SimpleNamespace(name="mug")
    return SimpleNamespace(
        grasp=grasp, object_model=model, confident=confident, warnings=warnings, acceptance=ACCEPTANCE
    )


def test_what_is_not_confident_is_not_tried() -> None:
    assert why_not_tried(seen("mug", True)) == ""
    assert why_not_tried(seen("mug", False, "dark")) == "not sure: 40 %; dark"
    assert "left hand" in why_not_tried(seen("mug_mirrored", True))


def test_the_grasp_of_a_file() -> None:
    choice = GraspChoice(grasp="mug:drink", threads=1)
    robot, objects = choice.robot(load_hand("allegro"))
    assert (len(robot), robot.hand, list(objects)) == (1, "allegro", ["mug"])
    assert choice.words == "mug:drink"


def test_the_grasp_in_an_image(monkeypatch: pytest.MonkeyPatch) -> None:
    grasp = builtin_grasps()[0]
    model = builtin_object(grasp.object_name)
    asked: list[Any] = []
    found = SimpleNamespace(
        grasp=grasp,
        grasps=HumanGraspSet.of([grasp]),
        object_model=model,
        objects={model.name: model},
        confident=True,
        acceptance=ACCEPTANCE,
        warnings=(),
    )

    def perceive(folder: str, mesh: str, mass: float | None, **options: Any) -> Any:
        asked.append((folder, mesh, mass, options["seed"]))
        return found

    monkeypatch.setattr("fungrasp.perception.pipeline.perceive_folder", perceive)
    choice = GraspChoice(image="photo", mesh="mug", mass=0.3)
    human, objects = choice.human(seed=4)
    assert asked == [("photo", "mug", 0.3, 4)]
    assert objects == {model.name: model} and human.object_name[0] == model.name
    assert choice.words == "image photo"
    found.confident = False
    with pytest.raises(FungraspError, match=r"not sure.*fungrasp perceive"):
        choice.robot(load_hand("allegro"))
