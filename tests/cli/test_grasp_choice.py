"""Where the grasp of a deployment comes from."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fungrasp.cli.deploy import Deploy
from fungrasp.cli.grasp_choice import MOST_IMAGES, GraspChoice
from fungrasp.errors import FungraspError
from fungrasp.grasps import HumanGrasp, HumanGraspSet, builtin_grasps
from fungrasp.hands import load_hand
from fungrasp.objects import mirrored_object


def _looks(monkeypatch: pytest.MonkeyPatch, confident: list[bool], mirrored: bool = False) -> list[int]:
    """Images in place of rendered ones, whose grasp is the true one, seen with confidence or not."""
    seen: list[int] = []

    def render(grasp: HumanGrasp, model: Any, rng: np.random.Generator) -> Any:
        return SimpleNamespace(capture=grasp)

    def perceive(capture: HumanGrasp, model: Any, **options: Any) -> Any:
        seen.append(options["seed"])
        name = mirrored_object(model).name if mirrored else model.name
        grasp = replace(capture, object_name=name)
        return SimpleNamespace(
            grasp=grasp,
            grasps=HumanGraspSet.of([grasp]),
            objects={name: model},
            confident=confident[len(seen) - 1],
            warnings=("dark",),
        )

    monkeypatch.setattr("fungrasp.synthetic_captures.render_capture.render_capture", render)
    monkeypatch.setattr("fungrasp.perception.pipeline.perceive", perceive)
    return seen


def test_images_are_taken_until_one_is_good(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = _looks(monkeypatch, [False, False, True])
    choice = GraspChoice(grasp="wine_glass", image="rendered", threads=1)
    chosen = choice.chosen(load_hand("allegro"), seed=4)
    assert chosen.images == 3
    assert seen == [4, 4, 4]
    assert chosen.thing.name == "wine_glass"
    assert choice.varies
    # What was seen is what was shown: the grasp of the file.
    plain = GraspChoice(grasp="wine_glass", threads=1).chosen(load_hand("allegro"))
    assert plain.images == 0
    np.testing.assert_allclose(chosen.grasp.joint_positions, plain.grasp.joint_positions, atol=1e-9)


@pytest.mark.parametrize(("mirrored", "said"), [(False, r"low confidence .*dark"), (True, "left hand")])
def test_what_is_not_sure_is_not_tried(monkeypatch: pytest.MonkeyPatch, mirrored: bool, said: str) -> None:
    seen = _looks(monkeypatch, [mirrored] * MOST_IMAGES, mirrored)
    with pytest.raises(FungraspError, match=said):
        GraspChoice(grasp="mug", image="rendered", threads=1).chosen(load_hand("allegro"))
    assert len(seen) == MOST_IMAGES


def test_a_folders_image_is_refused_too(monkeypatch: pytest.MonkeyPatch) -> None:
    grasp = builtin_grasps()[0]
    model = SimpleNamespace(name=grasp.object_name)
    doubtful = SimpleNamespace(grasp=grasp, object_model=model, confident=False, warnings=())
    monkeypatch.setattr("fungrasp.report.demo_capture.perceive_image", lambda *a, **k: (doubtful, []))
    with pytest.raises(FungraspError, match=r"low confidence.*fungrasp perceive"):
        GraspChoice(image="photo", mesh="mug").chosen(load_hand("allegro"))


def test_a_rendered_image_has_its_own_object() -> None:
    with pytest.raises(FungraspError, match="--mesh and --mass need a folder"):
        GraspChoice(image="rendered", mesh="mug").chosen(load_hand("allegro"))


def test_the_commands_share_the_options() -> None:
    from benchmarks.wire.series import BenchWire
    from fungrasp.cli.robots import Emulate

    assert isinstance(Deploy().choice, GraspChoice)
    assert isinstance(Emulate().choice, GraspChoice)
    assert BenchWire().choice.grasp == "wine_glass"
