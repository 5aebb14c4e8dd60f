"""A plan of the whole way, kept in a file to be looked at before it is carried out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import parse_json
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.deployment.deployment import MOVED
from fungrasp.deployment.deployment_result import DeploymentSpec
from fungrasp.deployment.preparation import PreparedGrasp
from fungrasp.deployment.rehearsal import Motion
from fungrasp.geometry.poses import relative, rotation_vector
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.grasp_files import robot_grasp_fields, robot_grasps_from_fields
from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec
from fungrasp.objects import ObjectModel, load_object, resolve_object
from fungrasp.policies.registry import policy_files
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.kinematics.reach import Reach
from fungrasp.task import GraspPlan

OBJECT_DISTANCE = 0.01
"""An object that is seen farther than this from where the plan has it [m] needs another plan; what is seen is
some millimeters off."""

OBJECT_TURN = 0.1
"""The same where it is turned by more [rad]: 6 degrees."""


@dataclass(frozen=True)
class ObjectSource:
    """Where the object of a plan is read from."""

    name: str
    """Of the object."""
    mass: float
    """That was planned for [kg]."""
    folder: str = ""
    """Of meshes; built-in objects need none."""
    file: str = ""
    """What was said of an object in an image, a mesh file or a name; "" for one that is found by its name."""

    def load(self) -> ObjectModel:
        """The object as it is now. Raises: FungraspError: it can't be read."""
        if self.file:
            return resolve_object(self.file, self.mass).model
        return load_object(self.name, self.mass, self.folder or None)


@dataclass(frozen=True)
class PlanOrigin:
    """What a plan was made of."""

    spec: DeploymentSpec
    """What was asked."""
    source: ObjectSource
    """The object."""
    about: str = ""
    """Which grasp, in words."""
    version: str = __version__
    """Of fungrasp."""
    digests: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of what it was made of, by its name."""


@dataclass(frozen=True, eq=False)
class SavedPlan:
    """A grasp that was planned where the robot stood and the object was seen."""

    origin: PlanOrigin
    """What it was made of."""
    grasp: RobotGraspSet
    """The grasp, one."""
    arm: np.ndarray
    """Joints of the arm where it begins [rad], shape [A]."""
    fingers: np.ndarray
    """Independent joints of the hand there [rad], shape [U]."""
    prepared: PreparedGrasp
    """The plan and the way to its start."""
    motion: Motion
    """Every setpoint of the whole way."""

    @property
    def digest(self) -> str:
        """SHA-256 of all that is in it."""
        return digest(self._arrays())

    def save(self, path: str | Path) -> None:
        """Write it to an ``.npz`` file, whole or not at all.

        Raises:
            FungraspError: the file can't be written.
        """
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **self._arrays(), digest=np.array(self.digest))  # pyright: ignore[reportArgumentType]

    def words(self) -> str:
        """The plan in a line."""
        x, y, z = self.prepared.plan.object_pose[0, :3]
        legs, seconds = len(self.prepared.corners), self.motion.times[-1]
        return (
            f"'{self.origin.source.name}' at ({x:.3f}, {y:.3f}, {z:.3f}) m, {legs} legs to the start, "
            f"{seconds:.0f} s in all at full speed"
        )

    def _arrays(self) -> dict[str, np.ndarray]:
        p = self.prepared
        single = {
            "arm": self.arm,
            "fingers": self.fingers,
            "corners": np.array(p.corners),
            "start_fingers": p.start_fingers,
            "reach_start": p.reach.start,
            "reach_end": p.reach.end,
            "reach_margin": np.array(p.reach.margin),
        }
        grasp = robot_grasp_fields(self.grasp)
        parts = {"plan": p.plan.arrays(), "grasp": grasp, "motion": vars(self.motion)}
        nested = {f"{part}.{name}": value for part, one in parts.items() for name, value in one.items()}
        return {"origin": np.array(json.dumps(record_to_json(self.origin))), **single, **nested}


@guarded("saved plan")
def load_plan(path: str | Path) -> SavedPlan:
    """Read what ``SavedPlan.save`` wrote.

    Raises:
        FungraspError: no such file, or it is not as it was written.
    """
    arrays = read_npz(path, "saved plan")
    if "digest" not in arrays or "origin" not in arrays:
        raise FungraspError(f"{path} is no saved plan: 'fungrasp deploy --save-plan' writes one")
    written = str(arrays.pop("digest"))

    def part(name: str) -> dict[str, np.ndarray]:
        return {k.removeprefix(f"{name}."): v for k, v in arrays.items() if k.startswith(f"{name}.")}

    where = f"the saved plan {path}"
    origin = record_from_json(PlanOrigin, parse_json(str(arrays["origin"]), where), where)
    reach = Reach(arrays["reach_start"], arrays["reach_end"], float(arrays["reach_margin"]), "")
    plan = GraspPlan.from_arrays(part("plan"))
    prepared = PreparedGrasp(plan, arrays["start_fingers"], reach, tuple(arrays["corners"]))
    motion = Motion(**{f.name: part("motion")[f.name] for f in fields(Motion)})
    grasp = robot_grasps_from_fields(part("grasp"), str(path))
    saved = SavedPlan(origin, grasp, arrays["arm"], arrays["fingers"], prepared, motion)
    if saved.digest != written:
        raise FungraspError(f"{where} is not as it was written: make another one")
    return saved


def digests(cell: RobotCell, hand: Hand, thing: ObjectModel, policy: str, dynamics: str) -> dict[str, str]:
    """SHA-256 of what a plan is made of, by its name.

    Args:
        cell: the robot, with what its files say.
        hand: on its arm.
        thing: the object.
        policy: that carries the plan out.
        dynamics: file of the hand's identified dynamics, "" for the model's.
    """
    return {
        "robot cell": digest(
            replace(cell, hand_dynamics="", stop_file="", arm=replace(cell.arm, model="")),
            arm_spec(cell.arm.model).to_xml(),
        ),
        "hand": hand.digest,
        "object": digest(thing.vertices, thing.faces, thing.mass),
        "policy": digest(policy_files(policy, hand.name).digests()),
        "identified dynamics": digest(Path(dynamics).read_bytes()) if dynamics else "",
    }


def check_unchanged(saved: SavedPlan, now: Mapping[str, str]) -> None:
    """Compare what a plan was made of with what there is. now: ``digests``.

    Raises:
        FungraspError: something differs; says what.
    """
    for name, value in saved.origin.digests.items():
        if now.get(name) != value:
            raise FungraspError(
                f"the {name} is not the one that this plan was made with: plan anew with 'fungrasp deploy "
                "--save-plan'"
            )


class SavedPlanPreparer:
    """A ``Preparer`` that gives a saved plan, where object and arm are as it was made for."""

    def __init__(self, saved: SavedPlan, objects: Mapping[str, ObjectModel]):
        """
        Args:
            saved: the plan.
            objects: its object by name.
        """
        self._saved, self.objects = saved, objects

    def prepare(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0
    ) -> PreparedGrasp:
        """The plan, of which the way to the start is left out where the arm is there already. See
        ``Preparer.prepare``.

        Raises:
            FungraspError: object or arm is somewhere else; says how far.
        """
        prepared = self._saved.prepared
        apart = relative(prepared.plan.object_pose[0], object_pose)
        far, turn = float(np.linalg.norm(apart[:3])), float(np.linalg.norm(rotation_vector(apart[3:])))
        if far > OBJECT_DISTANCE or turn > OBJECT_TURN:
            raise FungraspError(
                f"'{self._saved.origin.source.name}' is {1e3 * far:.0f} mm and {np.rad2deg(turn):.0f} "
                f"degrees from where the plan has it, more than {1e3 * OBJECT_DISTANCE:.0f} mm or "
                f"{np.rad2deg(OBJECT_TURN):.0f} degrees: put it back, or plan anew"
            )
        way = (self._saved.arm, *prepared.corners)
        away = [float(np.abs(arm - posture).max()) for posture in (way[0], way[-1])]
        if away[0] <= MOVED:
            return prepared
        if away[1] <= MOVED:
            return replace(prepared, corners=way[-1:], behind=way[-2::-1])
        raise FungraspError(
            f"the arm is {min(away):.2f} rad from where the plan begins and from the start of its grasp, "
            f"more than {MOVED:g} rad: move it there, or plan anew"
        )
