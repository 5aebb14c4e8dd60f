"""Convert grasps and objects from all accepted forms of arguments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Protocol, TypeAlias

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.grasps.grasp_set import OTHER_MESH
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.robot_grasp import RobotGrasp, RobotGraspSet
from fungrasp.objects import ObjectModel, check_objects, load_object
from fungrasp.objects.object_registry import check_density

Objects: TypeAlias = "Mapping[str, ObjectModel] | Iterable[ObjectModel] | ObjectModel | str | Path | None"
"""Objects of grasps: a mapping by name, a list, a single object, or a folder of meshes. None: attached and
built-in objects."""

GIVE_OBJECTS = "objects= takes a folder of meshes or fungrasp.object_from_mesh(...), --objects a folder"
"""Remedy for objects that are not found."""


class HasGrasps(Protocol):
    """A result with grasps, such as a perceived grasp or the result of a lift test."""

    @property
    def grasps(self) -> HumanGraspSet | RobotGraspSet | None:
        """Grasps of the result."""
        ...


AnyGrasps: TypeAlias = "HumanGraspSet | RobotGraspSet | HumanGrasp | RobotGrasp | HasGrasps"
"""Human or robot grasps: a set, a single grasp, or a result with grasps."""

HumanGrasps: TypeAlias = "HumanGraspSet | HumanGrasp | HasGrasps"
"""Human grasps: a set, a single grasp, or a result with grasps."""


def as_grasp_set(grasps: AnyGrasps) -> HumanGraspSet | RobotGraspSet:
    """Convert grasps to a set.

    Raises:
        FungraspError: the argument has another type.
    """
    grasps = getattr(grasps, "grasps", grasps)
    if isinstance(grasps, HumanGrasp):
        return HumanGraspSet.of([grasps])
    if isinstance(grasps, RobotGrasp):
        return RobotGraspSet.of([grasps])
    if isinstance(grasps, HumanGraspSet | RobotGraspSet):
        return grasps
    if isinstance(grasps, list | tuple):
        remedy = "HumanGraspSet.of and RobotGraspSet.of make a set of single grasps"
    elif isinstance(grasps, str | Path):
        remedy = "fungrasp.load_grasps reads a file of grasps"
    else:
        remedy = "fungrasp.human_grasp makes one of arrays"
    raise FungraspError(f"expected human or robot grasps, not a {type(grasps).__name__}: {remedy}")


def as_human_grasps(grasps: HumanGrasps) -> HumanGraspSet:
    """Convert human grasps to a set.

    Raises:
        FungraspError: the argument contains robot grasps or has another type.
    """
    found = as_grasp_set(grasps)
    if isinstance(found, RobotGraspSet):
        raise FungraspError(
            f"only human grasps can be retargeted, not a {type(grasps).__name__} (of the hand '{found.hand}')"
        )
    return found


def load_objects(grasps: AnyGrasps, objects: Objects = None) -> dict[str, ObjectModel]:
    """Return the objects of grasps and other given objects, by name: those that the grasps carry, else
    built-in ones. Loaded objects have the mass of their first grasp.

    Args:
        grasps: grasps, or a result with grasps.
        objects: models, or a folder of meshes ``<name>.obj``; with precedence over other objects.

    Raises:
        FungraspError: the argument is not grasps, an object is missing or cannot be read, or a loaded object
            is another one than that of the grasps.
    """
    grasps = as_grasp_set(grasps)
    names, masses = grasps.object_name.tolist(), grasps.object_mass.tolist()
    return named_objects(names, masses, objects, grasps.objects, grasps.object_bounds)


def named_objects(
    names: Sequence[str],
    masses: Sequence[float],
    objects: Objects = None,
    carried: Mapping[str, ObjectModel] = MappingProxyType({}),
    bounds: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> dict[str, ObjectModel]:
    """Return the named objects and other given objects, by name.

    Args:
        names: names of the needed objects, possibly repeated.
        masses: their masses [kg]; a loaded object has the mass of its first occurrence.
        objects: given objects.
        carried: objects attached to the grasps; ``objects`` has precedence.
        bounds: known ``ObjectModel.bounds`` of the needed objects by name, which loaded meshes must have.

    Raises:
        FungraspError: an object is missing, or a loaded mesh has other bounds.
    """
    needed = {}
    for name, mass in zip(names, masses, strict=True):
        needed.setdefault(name, float(mass))
    if objects is None or isinstance(objects, str | Path):
        known = {} if objects is not None else dict(carried)
        try:
            loaded = {n: load_object(n, m, objects) for n, m in needed.items() if n not in known}
        except UnknownNameError as error:
            raise FungraspError(f"{error} Give the grasps' objects: {GIVE_OBJECTS}") from None
        for name, model in loaded.items():
            check_density(model)
            if name in bounds and np.abs(model.bounds - bounds[name]).max() > OTHER_MESH:
                raise FungraspError(
                    f"the known object '{name}' is not that of the grasps: the corners of its mesh are "
                    f"{model.bounds.round(3).tolist()} m, theirs {bounds[name].round(3).tolist()} m; give "
                    f"their objects: {GIVE_OBJECTS}"
                )
        return known | loaded
    if isinstance(objects, ObjectModel) or not isinstance(objects, Iterable):
        objects = [objects]
    given = dict(objects) if isinstance(objects, Mapping) else {getattr(o, "name", ""): o for o in objects}
    for model in given.values():
        if not isinstance(model, ObjectModel):
            raise FungraspError(
                "expected objects (fungrasp.load_object, fungrasp.object_from_mesh) or a folder of meshes, "
                f"not a {type(model).__name__}"
            )
    known = {**carried, **given}
    check_objects(names, known)
    return known


def picked_rows(
    grasps: HumanGraspSet | RobotGraspSet, picks: Sequence[str], count: int = 1, favorites: Sequence[str] = ()
) -> list[int]:
    """Return the rows of picked grasps; without picks, those of favorites, of other objects, then all others.

    Args:
        grasps: N grasps.
        picks: "object" or "object:task", for the first such grasp, or a row number.
        count: number of rows if there are no picks.
        favorites: preferred picks in this case; unknown ones are ignored.

    Raises:
        FungraspError: a grasp does not exist, or is picked twice.
    """
    assert grasps.task is not None
    first: dict[str, int] = {}
    for row, (name, task) in enumerate(zip(grasps.object_name.tolist(), grasps.task.tolist(), strict=True)):
        first.setdefault(name, row)
        first.setdefault(f"{name}:{task}", row)
    if not picks:
        others = [row for name, row in first.items() if ":" not in name]
        rows = [first[name] for name in favorites if name in first]
        shown = {grasps.object_name[row] for row in rows}
        rows += [row for row in others if grasps.object_name[row] not in shown]
        rows += sorted(set(range(len(grasps))) - set(rows))
        return rows[:count]
    rows = []
    for pick in picks:
        if pick not in first and pick.isdecimal():
            if int(pick) >= len(grasps):
                raise FungraspError(f"--grasp {pick}: the grasps are numbered 0 to {len(grasps) - 1}")
            rows.append(int(pick))
        elif pick in first:
            rows.append(first[pick])
        else:
            raise UnknownNameError("grasp", pick, first)
    if len(set(rows)) < len(rows):
        raise FungraspError(f"--grasp {' '.join(picks)}: grasp {max(rows, key=rows.count)} is picked twice")
    return rows
