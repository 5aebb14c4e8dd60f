"""Grasps as perception sees them in rendered images, for tests of the whole way from image to robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from fungrasp.grasps import HumanGraspSet
    from fungrasp.jobs import PartStore
    from fungrasp.objects import ObjectModel
    from fungrasp.perception.hand.detected_hand import HandDetector


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
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    images: int,
    seed: int,
    store: PartStore | None = None,
) -> SeenGrasps:
    """Render images of grasps and perceive them: neither mask nor pose is told.

    Args:
        human: grasps of right hands.
        objects: by name.
        images: of each grasp; image k of grasp i has the number i images + k.
        seed: of cameras, rooms and noise.
        store: keeps what was seen, and knows what an earlier run has seen.

    Raises:
        FungraspError: the models of hands are not set up.
    """
    from fungrasp.cli.console import progress_bar
    from fungrasp.files import digest
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
    from fungrasp.version import __version__

    detector = MediaPipeHandDetector()
    sets, index, refused = [], [], {}
    with progress_bar("perceiving", len(human) * images) as show:
        for number in range(len(human) * images):
            row, image = divmod(number, images)
            one, model = human.select([row]), objects[human.object_name[row]]
            fields = {name: getattr(one, name) for name in one.FIELDS}
            key = digest("image", __version__, fields, model.digest, seed, row, image)
            seen = None if store is None else store.load(key)
            if seen is None:
                seen = _seen(one, model, detector, [seed, row, image])
                if store is not None:
                    store.save(key, seen)
            if "refused" in seen:
                refused[number] = str(seen["refused"])
            else:
                sets.append(HumanGraspSet(**seen))
                index.append(number)
            show(number + 1)
    return SeenGrasps(HumanGraspSet.concatenate(sets) if sets else None, index, refused)


def _seen(
    one: HumanGraspSet, model: ObjectModel, detector: HandDetector, seed: list[int]
) -> dict[str, np.ndarray]:
    """Fields of the grasp that is seen in an image of a grasp; ``refused`` alone, with why it is not trusted.
    seed: of the image; the first number is that of perception."""
    import numpy as np

    from fungrasp.errors import FungraspError
    from fungrasp.perception.pipeline import perceive
    from fungrasp.synthetic_captures.render_capture import render_capture

    made = render_capture(one[0], model, np.random.default_rng(seed))
    try:
        seen = perceive(made.capture, model, detector=detector, seed=seed[0])
    except FungraspError as error:
        return {"refused": np.asarray(str(error))}
    if not seen.confident:
        return {"refused": np.asarray("low confidence: " + "; ".join(map(str, seen.warnings)))}
    if seen.grasp.object_name != model.name:
        return {"refused": np.asarray("taken for a left hand")}
    found = seen.grasps
    known = {name: getattr(found, name) for name in found.FIELDS}
    return {name: value for name, value in known.items() if value is not None}
