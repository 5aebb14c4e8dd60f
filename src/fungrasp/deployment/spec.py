"""Settings and phases of a deployment, and the choice of its grasp, for commands: without heavy imports."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from fungrasp.core.records import CheckedRecord

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel
    from fungrasp.perception.perceived import Perceived

Until = Literal["plan", "approach", "grasp", "lift", "put-down", "home"]
"""Last phase of a deployment."""


class Phase(StrEnum):
    """Phases of a deployment."""

    IDLE = "idle"
    """Connected: locates the object and plans. Nothing moves."""
    MOVE_TO_START = "move to start"
    """The arm goes to the start of the plan."""
    GRASP = "grasp"
    """The policy approaches and closes the hand."""
    LIFT = "lift"
    """The palm rises."""
    HOLD = "hold"
    """The object is held."""
    PUT_DOWN = "put down"
    """The object is lowered and released, and the palm withdraws."""
    HOME = "home"
    """The arm goes back to where it was."""
    DONE = "done"
    """The end."""
    FAULT = "fault"
    """Stopped: a person has to look and to start again."""
    WITHDRAW = "withdraw"
    """The object is not held: the hand opens and withdraws, and the object is located."""


LAST_PHASES: dict[Until, Phase] = {
    "plan": Phase.IDLE,
    "approach": Phase.MOVE_TO_START,
    "grasp": Phase.GRASP,
    "lift": Phase.HOLD,
    "put-down": Phase.PUT_DOWN,
    "home": Phase.HOME,
}
"""Last phase for each ``DeploymentSpec.until``; the robot then stays where it is."""


@dataclass(frozen=True)
class DeploymentSpec(CheckedRecord):
    """Settings of a deployment; ``fungrasp.core.records`` converts them to JSON."""

    cell: Annotated[str, tyro.conf.arg(name="robot")] = "ur5e-allegro"
    """A robot cell: built-in (`fungrasp robots list`), or a TOML file."""
    policy: str = "plan"
    """What moves the hand: "plan" or "reference" (planned motions, open loop), "student", or a policy
    file."""
    attempts: int = 1
    """Maximum number of attempts. A policy with feedback (student) notices that the object is not held; the
    hand withdraws, and the object is located, planned for and grasped again."""
    until: Until = "home"
    """Where to end: "plan" (nothing moves), "approach" (at the start of the grasp), "grasp" (fingers closed),
    "lift" (after the hold, with the object held), "put-down" or "home"."""
    speed: float = 1.0
    """Slow motion: share of the plan's speed, 0.02 to 1. The hold keeps its duration. Not for policies with
    feedback (student)."""
    gravity_compensation: bool = True
    """Compensate the weight of the hand's links."""
    hand_dynamics: str = ""
    """Identified dynamics of the hand (`fungrasp identify fit`). Empty: the file that the cell names."""
    seed: int = 0
    """Seed of the plan."""
    twin: int = 0
    """For a twin: its number, 0, 1, 2 ... It determines the hidden parameters."""
    real_time: Annotated[bool, tyro.conf.Suppress] = False
    """For a twin: run in real time; else as fast as possible, with the same result to the last bit."""
    look_time: Annotated[float, tyro.conf.Suppress] = 1.0
    """Time in which poses of the object are collected before planning [s]."""
    threads: Annotated[int, tyro.conf.Suppress] = 0
    """Threads of the planner; 0 means all processors, on a robot all but one, which its drivers need."""
    about: Annotated[str, tyro.conf.Suppress] = ""
    """Description of the grasp for the log."""


@dataclass(frozen=True)
class GraspChoice:
    """Choice of the grasp."""

    grasp: str = "wine_glass"
    """The grasp: an object ("mug"), object and task ("mug:drink") or a row number."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    image: str | None = None
    """Take the grasp from an RGB-D image instead: a folder with rgb.png, depth.png and K.json, or
    "builtin"."""
    mesh: str | None = None
    """The object in the folder's image: a mesh file [m], or the name of a built-in object."""
    mass: float | None = None
    """Mass of that object [kg]. Default: known for built-in objects."""
    threads: int = 0
    """Threads of retargeting and planning; 0 means all processors."""

    @property
    def words(self) -> str:
        """Description of the grasp for a log."""
        return self.grasp if self.image is None else f"image {self.image}"

    def human(self, seed: int = 0) -> tuple[HumanGraspSet, dict[str, ObjectModel]]:
        """Load the person's grasp, and its object by name. seed: for estimates from an image. Raises:
        FungraspError: no such grasp or image, no hand in the image, or estimates that are too uncertain."""
        if self.image is not None:
            return self._of_image(self.image, seed)
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.grasps.grasp_arguments import picked_rows

        everything = load_human_grasps(self.grasps)
        human = everything.select(picked_rows(everything, (self.grasp,)))
        return human, dict(load_objects(human, self.objects))

    def robot(self, hand: Hand, seed: int = 0) -> tuple[RobotGraspSet, dict[str, ObjectModel]]:
        """Return the grasp retargeted to a robot hand, and its object by name, for ``deploy``. Raises what
        ``human`` raises."""
        from fungrasp.retargeting import retarget

        human, objects = self.human(seed)
        return retarget(human, objects, hand, threads=self.threads), objects

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
    """Return why a robot should not try an estimated grasp, as a phrase; "" if it may."""
    if perceived.grasp.object_name != perceived.object_model.name:
        # Grasps of left hands are mirrored together with their object, and the real object is not mirrored.
        return "it shows a left hand, and robots have right ones"
    if not perceived.confident:
        return "; ".join((perceived.acceptance.summary(), *map(str, perceived.warnings)))
    return ""
