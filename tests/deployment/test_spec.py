"""Where the grasp of a deployment comes from."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from fungrasp.cli.deploy import Deploy
from fungrasp.cli.robots import Emulate
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.spec import GraspChoice, why_not_tried
from fungrasp.grasps import HumanGraspSet, builtin_grasps
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object

VERDICT = SimpleNamespace(words="not sure: 40 %")


def seen(name: str, confident: bool, *warnings: str) -> Any:
    """What is seen of the mug."""
    grasp = SimpleNamespace(object_name=name)
    model = SimpleNamespace(name="mug")
    return SimpleNamespace(
        grasp=grasp, object_model=model, confident=confident, warnings=warnings, verdict=VERDICT
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
        verdict=VERDICT,
        warnings=(),
    )

    def perceive(folder: str, mesh: str, mass: float | None, **options: Any) -> Any:
        asked.append((folder, mesh, mass, options["seed"]))
        return found

    monkeypatch.setattr("fungrasp.perception.builtin_image.perceive_folder", perceive)
    choice = GraspChoice(image="photo", mesh="mug", mass=0.3)
    human, objects = choice.human(seed=4)
    assert asked == [("photo", "mug", 0.3, 4)]
    assert objects == {model.name: model} and human.object_name[0] == model.name
    assert choice.words == "image photo"
    found.confident = False
    with pytest.raises(FungraspError, match=r"not sure.*fungrasp perceive"):
        choice.robot(load_hand("allegro"))


def test_the_commands_share_the_options() -> None:
    assert isinstance(Deploy().choice, GraspChoice)
    assert isinstance(Emulate().choice, GraspChoice)
