"""Grasps as perception sees them in rendered images, for tests of the whole way from image to robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.objects import ObjectModel


@dataclass(frozen=True, eq=False)
class SeenGrasps:
    """What perception saw."""

    human: HumanGraspSet | None
    """The grasps that it is confident of; None if there are none."""
    index: list[int]
    """Image of each of them."""
    refused: dict[int, str]
    """Why it is not, by image."""


def grasps_from_images(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], images: int, seed: int
) -> SeenGrasps:
    """Render images of grasps and perceive them: neither mask nor pose is told.

    Args:
        human: grasps of right hands.
        objects: by name.
        images: of each grasp; image k of grasp i has the number i images + k.
        seed: of cameras, rooms and noise.

    Raises:
        FungraspError: the models of hands are not set up.
    """
    import numpy as np

    from fungrasp.captures.render_capture import render_capture
    from fungrasp.cli.console import progress_bar
    from fungrasp.cli.perceive import one_grasp
    from fungrasp.errors import FungraspError
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
    from fungrasp.perception.pipeline import perceive

    detector = MediaPipeHandDetector()
    sets, index, refused = [], [], {}
    with progress_bar("perceiving", len(human) * images) as show:
        for number in range(len(human) * images):
            row, image = divmod(number, images)
            model = objects[human.object_name[row]]
            made = render_capture(human[row], model, np.random.default_rng([seed, row, image]))
            try:
                seen = perceive(made.capture, model, detector=detector, seed=seed)
                if not seen.confident:
                    refused[number] = "low confidence: " + "; ".join(map(str, seen.warnings))
                elif seen.grasp.object_name != model.name:
                    refused[number] = "taken for a left hand"
                else:
                    sets.append(one_grasp(seen.grasp))
                    index.append(number)
            except FungraspError as error:
                refused[number] = str(error)
            show(number + 1)
    return SeenGrasps(HumanGraspSet.concatenate(sets) if sets else None, index, refused)
