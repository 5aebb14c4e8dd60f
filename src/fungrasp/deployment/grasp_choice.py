"""The grasp that a robot is to do: one of a file, or the one in an image.

What finds it is imported on use: ``GraspChoice`` is options of commands, whose help comes at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fungrasp.deployment.saved_plan import ObjectSource
    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel
    from fungrasp.perception.perceived import Perceived


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
    "builtin", the one of `fungrasp demo`."""
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

    def human(self, seed: int = 0) -> tuple[HumanGraspSet, dict[str, ObjectModel]]:
        """The grasp as a person showed it, and its object by name.

        Args:
            seed: of what is drawn on the way from an image.

        Raises:
            FungraspError: no such grasp or image, no hand is seen in it, or what is seen is too uncertain.
        """
        if self.image is not None:
            return self._of_image(self.image, seed)
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.grasps.picks import picked_rows

        everything = load_human_grasps(self.grasps)
        human = everything.select(picked_rows(everything, (self.grasp,)))
        return human, dict(load_objects(human, self.objects))

    def robot(self, hand: Hand, seed: int = 0) -> tuple[RobotGraspSet, dict[str, ObjectModel]]:
        """The grasp, retargeted to a hand, and its object by name, as ``deploy`` takes them.

        Args:
            hand: of the robot.
            seed: as of ``human``.

        Raises:
            FungraspError: as ``human``.
        """
        from fungrasp.retargeting import retarget

        human, objects = self.human(seed)
        return retarget(human, objects, hand, threads=self.threads), objects

    def source(self, thing: ObjectModel) -> ObjectSource:
        """Where the object is read from again when a saved plan is carried out.

        Args:
            thing: the object.
        """
        from fungrasp.deployment.saved_plan import ObjectSource

        file = self.mesh if self.image is not None else None
        file = str(Path(file).resolve()) if file and Path(file).is_file() else file or ""
        folder = "" if self.objects is None else str(self.objects.resolve())
        return ObjectSource(thing.name, thing.mass, folder, file)

    def _of_image(self, folder: str, seed: int) -> tuple[HumanGraspSet, dict[str, ObjectModel]]:
        from fungrasp.core.errors import FungraspError
        from fungrasp.perception.pipeline import perceive_folder

        seen = perceive_folder(folder, self.mesh, self.mass, seed=seed)
        why = why_not_tried(seen)
        if why:
            raise FungraspError(
                f"image {folder}: {why}; look at it with 'fungrasp perceive', or take another"
            )
        return seen.grasps, seen.objects


def why_not_tried(perceived: Perceived) -> str:
    """Why a robot should not try what was seen, as a phrase; "" if nothing speaks against it."""
    if perceived.grasp.object_name != perceived.object_model.name:
        # A left hand's grasp is one of a right hand on the object's mirror image, which is not on the table.
        return "it shows a left hand, and robots have right ones"
    if not perceived.confident:
        return "; ".join((perceived.acceptance.summary(), *map(str, perceived.warnings)))
    return ""
