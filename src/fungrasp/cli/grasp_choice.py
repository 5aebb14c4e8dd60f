"""The grasp that a robot is to do: one of a file, or the one in an image."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel
    from fungrasp.perception.perceived import Perceived

RENDERED = "rendered"
"""Stands for an image that is rendered for the purpose."""

MOST_IMAGES = 5
"""Images that are rendered before the grasp counts as one that can't be seen; a person would hardly take
more."""


@dataclass(frozen=True, eq=False)
class ChosenGrasp:
    """A grasp for a robot."""

    grasp: RobotGraspSet
    """One."""
    thing: ObjectModel
    """Its object."""
    images: int
    """Images that were looked at, those of low confidence included; 0 where the grasp is not from an
    image."""
    seconds: float
    """Time from the image, or the file, to the robot grasp, rendering not included [s]."""


@dataclass(frozen=True)
class GraspChoice:
    """Which grasp a robot is to do."""

    grasp: str = "wine_glass"
    """Which grasp: an object ("mug"), object and task ("mug:drink") or a row number."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    image: str | None = None
    """Take the grasp from an image with depth instead: a folder with rgb.png, depth.png and K.json, or
    "builtin", the one of `fungrasp demo`; or "rendered": an image of --grasp is rendered for this, another
    one for each seed or run."""
    mesh: str | None = None
    """The object in the folder's image: a mesh file [m], or the name of a built-in object."""
    mass: float | None = None
    """Mass of that object [kg]; a built-in one has its own."""
    threads: int = 0
    """Of retargeting and planning; 0 means all processors."""

    @property
    def words(self) -> str:
        """Which grasp, for a log."""
        return self.grasp if self.image is None else f"image {self.image}"

    @property
    def varies(self) -> bool:
        """Whether another seed gives another grasp."""
        return self.image == RENDERED

    def chosen(self, hand: Hand, seed: int = 0) -> ChosenGrasp:
        """The grasp, retargeted to a hand.

        Args:
            hand: of the robot.
            seed: of what is drawn on the way from an image.

        Raises:
            FungraspError: no such grasp or image, no hand is seen in it, or what is seen is too uncertain.
        """
        from fungrasp.retargeting import retarget

        images, began = 0, time.monotonic()
        human: HumanGraspSet
        objects: Mapping[str, ObjectModel]
        if self.image is None:
            human, objects = self._of_file()
        elif self.image == RENDERED:
            human, objects, images, began = self._of_rendered_image(seed)
        else:
            human, objects, images = *self._of_folder(self.image, seed), 1
        robot = retarget(human, objects, hand, threads=self.threads)
        return ChosenGrasp(robot, objects[robot.object_name[0]], images, time.monotonic() - began)

    def _of_file(self) -> tuple[HumanGraspSet, Mapping[str, ObjectModel]]:
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.grasps.picks import picked_rows

        everything = load_human_grasps(self.grasps)
        human = everything.select(picked_rows(everything, (self.grasp,)))
        return human, load_objects(human, self.objects)

    def _of_folder(self, folder: str, seed: int) -> tuple[HumanGraspSet, Mapping[str, ObjectModel]]:
        from fungrasp.errors import FungraspError
        from fungrasp.report.demo_capture import perceive_image

        seen, _ = perceive_image(folder, self.mesh, self.mass, seed=seed)
        doubt = _doubt(seen, seen.object_model)
        if doubt:
            raise FungraspError(
                f"image {folder}: {doubt}; look at it with 'fungrasp perceive', or take another"
            )
        return seen.grasps, seen.objects

    def _of_rendered_image(self, seed: int) -> tuple[HumanGraspSet, Mapping[str, ObjectModel], int, float]:
        """As if a person took images until one is good enough; and when the last one was there."""
        import numpy as np

        from fungrasp.errors import FungraspError
        from fungrasp.perception.pipeline import perceive
        from fungrasp.synthetic_captures.render_capture import render_capture

        if self.mesh is not None or self.mass is not None:
            raise FungraspError("a rendered image has its own object: --mesh and --mass need a folder")
        human, objects = self._of_file()
        true = human[0]
        model, said = objects[true.object_name], ""
        for attempt in range(MOST_IMAGES):
            capture = render_capture(true, model, np.random.default_rng([seed, attempt])).capture
            began = time.monotonic()
            try:
                seen = perceive(capture, model, task=true.task, seed=seed)
            except FungraspError as error:
                # No hand is seen: another image, as where there are doubts.
                said = str(error)
                continue
            said = _doubt(seen, model)
            if not said:
                return seen.grasps, seen.objects, attempt + 1, began
        raise FungraspError(f"{MOST_IMAGES} rendered images of '{model.name}' were not good enough: {said}")


def _doubt(perceived: Perceived, model: ObjectModel) -> str:
    """Why a robot should not try what was seen, as a phrase; "" if nothing speaks against it."""
    if perceived.grasp.object_name != model.name:
        # A left hand's grasp is one of a right hand on the object's mirror image, which is not on the table.
        return "it shows a left hand, and robots have right ones"
    if not perceived.confident:
        warnings = "; ".join(map(str, perceived.warnings))
        return f"low confidence in the perceived grasp{f' ({warnings})' * bool(warnings)}"
    return ""
