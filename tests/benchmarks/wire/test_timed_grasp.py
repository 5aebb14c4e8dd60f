"""The grasp of a run over the wire: that of a file, or what is seen of it in rendered images."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.wire import timed_grasp as room
from benchmarks.wire.series import BenchWire
from benchmarks.wire.timed_grasp import MOST_IMAGES, rendered_grasp, timed_grasp
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.spec import GraspChoice
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.objects import mirrored_object

HAND = load_hand("allegro")


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
            object_model=model,
            objects={name: model},
            confident=confident[len(seen) - 1],
            verdict=SimpleNamespace(words="not sure: 20 % that all is right"),
            warnings=("dark",),
        )

    monkeypatch.setattr(room, "render_capture", render)
    monkeypatch.setattr(room, "perceive", perceive)
    return seen


def test_images_are_taken_until_one_is_good(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = _looks(monkeypatch, [False, False, True])
    choice = GraspChoice(grasp="wine_glass", threads=1)
    found = rendered_grasp(choice, HAND, seed=4)
    assert found.images == 3
    assert seen == [4, 4, 4]
    assert list(found.objects) == ["wine_glass"]
    # What was seen is what was shown: the grasp of the file.
    plain = timed_grasp(choice, HAND, seed=4)
    assert plain.images == 0 and plain.seconds > 0
    np.testing.assert_allclose(found.robot.joint_positions, plain.robot.joint_positions, atol=1e-9)


@pytest.mark.parametrize(("mirrored", "said"), [(False, r"not sure: 20 % .*dark"), (True, "left hand")])
def test_what_is_not_confident_is_not_tried(
    monkeypatch: pytest.MonkeyPatch, mirrored: bool, said: str
) -> None:
    seen = _looks(monkeypatch, [mirrored] * MOST_IMAGES, mirrored)
    with pytest.raises(FungraspError, match=said):
        rendered_grasp(GraspChoice(grasp="mug", threads=1), HAND, 0)
    assert len(seen) == MOST_IMAGES


def test_an_image_is_given_or_rendered() -> None:
    with pytest.raises(FungraspError, match="no --image beside it"):
        rendered_grasp(GraspChoice(image="photo", mesh="mug"), HAND, 0)
    assert BenchWire().choice.grasp == "wine_glass"
