"""Grasps as perception sees them in rendered images, for tests of the whole way from image to robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.synthetic_captures.render_capture import render_capture
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, PartStore, part_key
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
from fungrasp.perception.pipeline import perceive
from fungrasp.retargeting import retarget


class PerceivedGrasps:
    """Images of grasps, each rendered, perceived and retargeted when its turn comes;
    neither mask nor pose is given."""

    def __init__(
        self,
        human: HumanGraspSet,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        images: int,
        seed: int,
        store: PartStore,
        rows: Sequence[int] | None = None,
        threads: int = 0,
    ):
        """
        Args:
            human: grasps of right hands.
            objects: by name.
            hand: of the robot.
            images: of each grasp; image k of row i has the number i images + k.
            seed: of cameras, rooms and noise.
            store: keeps what was seen, and knows what an earlier run has seen.
            rows: of the grasps, to number their images; 0, 1, 2 ... if None.
            threads: of retargeting; 0 means all processors.
        """
        rows = range(len(human)) if rows is None else rows
        self.hand = hand.name
        self.numbers = [row * images + image for row in rows for image in range(images)]
        self.names = [name for name in human.object_name.tolist() for _ in range(images)]
        self.refused: dict[int, str] = {}
        """Why perception is not confident of an image, by its number."""
        self._human, self._objects, self._hand, self._images = human, objects, hand, images
        self._seed, self._store, self._threads, self._taken = seed, store, threads, 0

    def take(self, row: int) -> RobotGraspSet | None:
        """One grasp; None where perception is not confident of its image.

        Raises:
            FungraspError: the models of hands are not set up.
        """
        grasp, image = divmod(row, self._images)
        model = self._objects[self.names[row]]
        key = part_key("image", self._human.select([grasp]), model, self._seed, grasp, image)
        seen = self._store.kept(key, lambda: self._seen(grasp, image, model))
        self._taken += 1
        if "refused" in seen:
            self.refused[self.numbers[row]] = str(seen["refused"])
            return None
        fields: dict[str, Any] = dict(seen)
        return retarget(HumanGraspSet(**fields), self._objects, self._hand, threads=self._threads)

    @property
    def about(self) -> Mapping[str, Any]:
        """What the header of a result says of those that were taken so far."""
        return {"images": self._taken, "not_seen": {str(n): why for n, why in self.refused.items()}}

    @cached_property
    def _detector(self) -> HandDetector:
        return MediaPipeHandDetector()

    def _seen(self, grasp: int, image: int, model: ObjectModel) -> Arrays:
        """Fields of the grasp that is seen in an image; ``refused`` alone, with why it is not trusted."""
        # Models that are missing are nothing that an image is refused for.
        detector = self._detector
        made = render_capture(self._human[grasp], model, np.random.default_rng([self._seed, grasp, image]))
        try:
            seen = perceive(made.capture, model, detector=detector, seed=self._seed)
        except FungraspError as error:
            return {"refused": np.asarray(str(error))}
        if not seen.confident:
            return {"refused": np.asarray("; ".join((seen.acceptance.summary(), *map(str, seen.warnings))))}
        if seen.grasp.object_name != model.name:
            return {"refused": np.asarray("taken for a left hand")}
        known = {name: getattr(seen.grasps, name) for name in HumanGraspSet.FIELDS}
        return {name: value for name, value in known.items() if value is not None}
