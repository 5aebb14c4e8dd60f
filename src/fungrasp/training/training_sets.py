"""Training grasps, held-out grasps, and their plans, which are stored in a file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
from fungrasp.grasps.grasp_arguments import AnyGrasps
from fungrasp.grasps.grasp_files import BUILTIN
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.planning.selection.candidates import vary, with_settings
from fungrasp.planning.selection.rollouts import roll_out
from fungrasp.planning.selection.settings import RolloutSettings
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retargeting import RetargetSpec, method_name, retarget
from fungrasp.retargeting.robot_grasps import as_robot_grasps
from fungrasp.sim2real import NOMINAL, draw
from fungrasp.simulation import Scene, SceneSettings, build_scene
from fungrasp.task import Belief, GraspPlan, LiftEnvironment
from fungrasp.training.settings import TrainSpec

_log = logging.getLogger(__name__)

BUILTIN_TERMS = "Apache-2.0, part of fungrasp"
"""Terms of the built-in grasps."""
LARGEST_LIBRARY = 1 << 33
"""Largest size of a file of plans that is read [bytes], enough for tens of thousands of grasps."""


CHUNK = 256
"""Grasps planned together."""

TRIAL = RolloutSettings(NOMINAL)
"""Rollouts that tell whether a planned motion holds."""


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """A set of training grasps."""

    name: str
    """Name of the data set, for the policy's card."""
    grasps: RobotGraspSet
    """The robot grasps."""
    objects: Mapping[str, ObjectModel]
    """The grasps' objects, by name."""
    terms: str = "not stated"
    """License terms of the grasps."""
    folder: Path | None = None
    """Folder of the objects' meshes; None for built-in objects."""

    def about(self) -> dict[str, Any]:
        """Return data that identifies the set."""
        names = np.unique(self.grasps.object_name).tolist()
        return {
            "name": self.name,
            "terms": self.terms,
            "count": len(self.grasps),
            "sha256": digest(
                {name: getattr(self.grasps, name) for name in self.grasps.FIELDS}, self.grasps.extra
            ),
            "objects": {name: self.objects[name].mesh_digest for name in names},
        }


Trainable: TypeAlias = "TrainingSet | AnyGrasps"
"""Grasps to train on."""


def as_training_sets(
    sets: Trainable | Sequence[Trainable], hand: Hand, threads: int = 0
) -> list[TrainingSet]:
    """Convert grasps to training sets of a hand; human grasps are retargeted.

    Raises:
        FungraspError: an argument is not grasps, grasps are of another hand, or an object is missing.
    """
    found = []
    for one in sets if isinstance(sets, Sequence) else (sets,):
        is_named = isinstance(one, TrainingSet)
        name, grasps, known = (one.name, one.grasps, one.objects) if is_named else ("grasps", one, None)
        try:
            robot, objects, _, _ = as_robot_grasps(grasps, known, hand, threads)
        except FungraspError as error:
            raise FungraspError(f"{name}: {error}") from error
        made = one if is_named else TrainingSet(name, robot, objects)
        found.append(replace(made, grasps=robot, objects=objects))
    return found


def load_training_sets(
    names: tuple[str, ...],
    folder: Path | None,
    hand: Hand,
    method: str = RetargetSpec.method,
    terms: tuple[str, ...] = (),
    threads: int = 0,
) -> list[TrainingSet]:
    """Load grasps of a hand from files; human grasps are retargeted.

    Args:
        names: files, or "builtin".
        terms: license terms, one per name or none.

    Raises:
        FungraspError: a file or an object can't be read, or the method is unknown.
    """
    method = method_name(method)
    if not names or len(set(names)) < len(names):
        raise FungraspError("--grasps needs at least one set, and each once")
    if terms and len(terms) != len(names):
        raise FungraspError(f"--terms needs one text for each of the {len(names)} --grasps, not {len(terms)}")
    sets = []
    for number, name in enumerate(names):
        grasps = load_grasps(name)
        place = None if name == BUILTIN else folder
        objects = load_objects(grasps, place)
        if isinstance(grasps, RobotGraspSet):
            robot, label = grasps, ""
        else:
            robot = retarget(grasps, objects, hand, method, threads=threads)
            label = f", retargeted with {method}"
        said = terms[number] if terms else BUILTIN_TERMS if name == BUILTIN else "not stated"
        title = "built-in grasps" if name == BUILTIN else Path(name).name
        sets.append(TrainingSet(title + label, robot, objects, said, place))
    return sets


def joined_objects(sets: Sequence[TrainingSet]) -> dict[str, ObjectModel]:
    """Return the objects of several sets, by name.

    Raises:
        FungraspError: there is no set, or two different objects have the same name.
    """
    if not sets:
        raise FungraspError("training needs at least one set of grasps")
    objects: dict[str, ObjectModel] = {}
    for one in sets:
        for name, obj in one.objects.items():
            if objects.setdefault(name, obj).mesh_digest != obj.mesh_digest:
                raise FungraspError(f"{one.name}: its object '{name}' is not that of another set")
    return objects


def split_sets(
    sets: Sequence[TrainingSet], share: float, seed: int
) -> tuple[list[TrainingSet], list[TrainingSet]]:
    """Split sets into training grasps and held-out grasps.

    Args:
        share: share of grasps to hold out of each set, rounded, 0 to below 1.

    Raises:
        FungraspError: none or all of a set's grasps would be held out.
    """
    if not share:
        return list(sets), []
    rng = np.random.default_rng(seed)
    parts: tuple[list[TrainingSet], list[TrainingSet]] = [], []
    for one in sets:
        count = len(one.grasps)
        number = round(share * count)
        if not 0 < number < count:
            raise FungraspError(f"{one.name}: {share:g} of its {count} grasps can't be held out")
        order = rng.permutation(count)
        for part, rows in zip(parts, (order[number:], order[:number]), strict=True):
            part.append(replace(one, grasps=one.grasps.select(np.sort(rows))))
    return parts


@dataclass(frozen=True, eq=False)
class PlanLibrary:
    """Training plans."""

    plans: GraspPlan
    """The plans, N rows."""
    group: np.ndarray
    """Row of the grasp of each plan, shape [N] int."""


def build_plan_library(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    spec: TrainSpec,
    progress: Callable[[int], None] = lambda done: None,
) -> PlanLibrary:
    """Plan variations of grasps.

    Raises:
        FungraspError: no grasp of the set has a usable plan.
    """
    copies, seed = spec.variety.copies, spec.seed
    group, attempt = np.repeat(np.arange(len(grasps)), copies), np.tile(np.arange(copies), len(grasps))
    start, scene = with_settings(grasps), build_scene(hand, objects)
    planner = MotionPlanner(hand, objects)
    trial = build_scene(hand, objects, SceneSettings(timestep=TRIAL.timestep)) if spec.variety.held else None
    parts, held = [], []
    for first in range(0, len(group), CHUNK):
        rows = slice(first, first + CHUNK)
        part = vary(start.select(group[rows]), hand, group[rows], attempt[rows], seed, spec.variety.spread)
        belief = LiftEnvironment(scene, len(part), threads=spec.threads).settle(part)
        parts.append(planner.plan(part, belief))
        if trial is not None:
            held.append(_held_as_shown(parts[-1], belief, trial, spec.threads))
        progress(first + len(part))
    plans = GraspPlan.join(parts)
    chosen = _usable(plans)
    if not chosen.any():
        raise FungraspError("none of the grasps can be trained on: no object settles, or no plan is finite")
    if held:
        chosen &= np.concatenate(held)
        if not chosen.any():
            raise FungraspError("no planned motion holds its object as shown: leave out variety.held")
    rows = np.flatnonzero(chosen)
    return PlanLibrary(plans.select(rows), group[rows])


def _held_as_shown(plans: GraspPlan, belief: Belief, scene: Scene, threads: int) -> np.ndarray:
    """Return whether planned motions hold the objects as shown in the believed world, shape [P] bool; if the
    person's contacts are unknown, whether they hold them at all."""
    sample = draw(NOMINAL, len(plans), len(scene.hand.joint_names), np.random.default_rng(0))
    return roll_out(plans, belief, sample, scene, OpenLoopPolicy(), TRIAL, threads).as_shown > 0


def _usable(plans: GraspPlan) -> np.ndarray:
    """Return whether plans are finite and their objects are on the table."""
    finite = np.isfinite(plans.palm_goal_object).all(axis=(1, 2)) & np.isfinite(plans.finger_targets).all(
        axis=(1, 2)
    )
    settled = plans.object_pose
    return finite & np.isfinite(settled).all(axis=1) & (np.abs(settled[:, 2]) < 0.5)


def planned_sets(
    sets: Sequence[TrainingSet],
    hand: Hand,
    spec: TrainSpec,
    progress: Callable[[int], None] = lambda done: None,
) -> PlanLibrary:
    """Plan the grasps of several sets; each grasp is a group.

    Raises:
        FungraspError: a set has no usable grasp; the message names the set.
    """
    parts: list[PlanLibrary] = []
    groups = done = 0
    for number, one in enumerate(sets):
        try:
            part = build_plan_library(
                one.grasps,
                one.objects,
                hand,
                replace(spec, seed=spec.seed + number),
                lambda count, before=done: progress(before + count),
            )
        except FungraspError as error:
            raise FungraspError(f"{one.name}: {error}") from error
        parts.append(PlanLibrary(part.plans, part.group + groups))
        groups += len(one.grasps)
        done += len(one.grasps) * spec.variety.copies
    return PlanLibrary(
        GraspPlan.join([part.plans for part in parts]), np.concatenate([part.group for part in parts])
    )


def kept_library(path: Path, key: str, plan: Callable[[], PlanLibrary]) -> PlanLibrary:
    """Read training plans from a file. If it is missing, damaged or from other inputs, plan and store them.

    Args:
        key: digest of everything that the library depends on.

    Raises:
        FungraspError: planning fails, or the file can't be written.
    """
    if path.is_file():
        try:
            arrays = read_npz(path, "plan library", largest=LARGEST_LIBRARY)
            if str(arrays.pop("key")) == key:
                group = arrays.pop("group")
                return PlanLibrary(GraspPlan.from_arrays(arrays), group)
            _log.warning("%s belongs to other grasps or settings: planning again", path)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            _log.warning("%s is unreadable (%s): planning again", path, error)
    library = plan()
    with atomic_path(path) as part, part.open("wb") as stream:
        arrays = {"key": np.array(key), "group": library.group} | library.plans.arrays()
        np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]
    return library
