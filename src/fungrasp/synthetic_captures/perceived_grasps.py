"""Grasps as perception sees them in rendered images, for tests of the whole way from image to robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.grasps import HumanGraspSet
from fungrasp.jobs import Arrays, Job, PartStore, part_key, run_job
from fungrasp.objects import ObjectModel
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
from fungrasp.perception.pipeline import perceive
from fungrasp.synthetic_captures.render_capture import render_capture


@dataclass(frozen=True, eq=False)
class SeenGrasps:
    """What perception saw."""

    human: HumanGraspSet
    """The grasps that it is confident of."""
    index: list[int]
    """Number of the image of each."""
    refused: dict[int, str]
    """Why it is not confident of the others, by the number of the image."""


def grasps_from_images(
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    images: int,
    seed: int,
    store: PartStore | None = None,
    progress: Callable[[float], None] = lambda share: None,
    rows: Sequence[int] | None = None,
) -> SeenGrasps:
    """Render images of grasps and perceive them: neither mask nor pose is given.

    Args:
        human: grasps of right hands.
        objects: by name.
        images: of each grasp; image k of row i has the number i images + k.
        seed: of cameras, rooms and noise.
        store: keeps what was seen, and knows what an earlier run has seen.
        progress: called with the share that is done, 0 to 1.
        rows: of the grasps, to number their images; 0, 1, 2 ... if None.

    Raises:
        FungraspError: the models of hands are not set up, or perception is confident of no image.
    """
    sets, index, refused = [], [], {}
    found = run_job(_PerceivedImages(human, objects, images, seed), store, progress=progress)
    for part, seen in enumerate(found):
        row, image = divmod(part, images)
        number = (row if rows is None else rows[row]) * images + image
        if "refused" in seen:
            refused[number] = str(seen["refused"])
        else:
            sets.append(HumanGraspSet(**seen))
            index.append(number)
    if not sets:
        raise FungraspError("perception is confident of no image: nothing to try")
    return SeenGrasps(HumanGraspSet.concatenate(sets), index, refused)


@dataclass(frozen=True, eq=False)
class _PerceivedImages(Job[int]):
    """Images of grasps, rendered and perceived; a part is the number of an image."""

    human: HumanGraspSet
    objects: Mapping[str, ObjectModel]
    images: int
    seed: int

    def parts(self) -> list[int]:
        return list(range(len(self.human) * self.images))

    def key(self, part: int) -> str:
        row, image = divmod(part, self.images)
        model = self.objects[self.human.object_name[row]]
        return part_key("image", self.human.select([row]), model, self.seed, row, image)

    def run(self, parts: Sequence[int], progress: Callable[[float], None]) -> list[Arrays]:
        return [self._seen(part) for part in parts]

    @cached_property
    def _detector(self) -> HandDetector:
        return MediaPipeHandDetector()

    def _seen(self, number: int) -> Arrays:
        """Fields of the grasp that is seen in an image; ``refused`` alone, with why it is not trusted."""
        # Models that are missing are nothing that an image is refused for.
        detector = self._detector
        row, image = divmod(number, self.images)
        true = self.human[row]
        model = self.objects[true.object_name]
        made = render_capture(true, model, np.random.default_rng([self.seed, row, image]))
        try:
            seen = perceive(made.capture, model, detector=detector, seed=self.seed)
        except FungraspError as error:
            return {"refused": np.asarray(str(error))}
        if not seen.confident:
            return {"refused": np.asarray("low confidence: " + "; ".join(map(str, seen.warnings)))}
        if seen.grasp.object_name != model.name:
            return {"refused": np.asarray("taken for a left hand")}
        known = {name: getattr(seen.grasps, name) for name in HumanGraspSet.FIELDS}
        return {name: value for name, value in known.items() if value is not None}
