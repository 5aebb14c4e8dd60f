"""Grasps from motions of hands and objects, with common functions of the importers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.formats.checks import guarded
from fungrasp.geometry.poses import compose, rotate, transform_points
from fungrasp.grasps.conversion import UP
from fungrasp.grasps.from_arrays import human_grasp
from fungrasp.grasps.human_grasp import HumanGrasp
from fungrasp.objects import ObjectModel, ResolvedObject, mesh_files, resolve_object

MOVED = 0.01
"""Distance from its first position beyond which an object counts as grasped [m]."""

LARGEST = 1 << 28
"""Largest size of a text file [bytes]."""

Item = TypeVar("Item")

_log = logging.getLogger(__name__)


def grasp_from_motion(
    joints: ArrayLike | Callable[[int], ArrayLike | None],
    object_pose: np.ndarray,
    mesh: ObjectModel | ResolvedObject | str | Path,
    *,
    order: str = "fungrasp",
    up: str = "z",
    task: str = "",
) -> HumanGrasp:
    """Return the grasp in the first frame with a hand in which the object has moved farther than ``MOVED``.

    Args:
        joints: joints of a right hand [m], world frame, shape [T, 21, 3], or a function from the index of a
            frame to joints, shape [21, 3], or None if the hand was not tracked.
        object_pose: poses of the object, world frame, shape [T, 7]. In the first frame, it rests on the table
            and its lowest point is at the table's height.
        mesh: the object, as in ``human_grasp``.
        order: joint order, as in ``human_grasp``.
        up: upward axis of the world, one of ``grasps.conversion.UP``.
        task: task of the grasp.

    Raises:
        FungraspError: the axis is unknown, the object never moves, the hand does not touch it when it moves,
            or ``human_grasp`` raises an error.
    """
    if up not in UP:
        raise UnknownNameError("axis", up, UP)
    turn = np.array([0.0, 0.0, 0.0, *UP[up]])
    for frame in moved_frames(object_pose[:, :3]):
        found = joints(int(frame)) if callable(joints) else np.asarray(joints)[frame]
        if found is not None:
            break
    else:
        raise FungraspError(f"no tracked hand moves the object by {MOVED:g} m")
    obj = resolve_object(mesh)
    rest, pose = compose(turn, object_pose[0]), compose(turn, object_pose[frame])
    down = np.array([0.0, 0.0, transform_points(rest, obj.model.vertices)[:, 2].min()])
    hand = rotate(turn[3:], np.asarray(found, dtype=float)) - down
    pose[:3] -= down
    grasp = human_grasp(hand, obj, order=order, object_pose=pose, task=task)
    if not grasp.link_contacts.any():
        raise FungraspError("the hand does not touch the object when it moves")
    return grasp


def moved_frames(positions: np.ndarray) -> np.ndarray:
    """Return the frames in which an object is farther than ``MOVED`` from its first tracked position.

    positions: [m], shape [T, 3]; NaN if the object was not tracked.
    """
    tracked = np.flatnonzero(np.isfinite(positions[:, 0]))
    if not len(tracked):
        return tracked
    return np.flatnonzero(np.linalg.norm(positions - positions[tracked[0]], axis=1) > MOVED)


def each(
    items: Iterable[Item], grasps: Callable[[Item], HumanGrasp | list[HumanGrasp]], none: str
) -> list[HumanGrasp]:
    """Return the grasps of usable sequences or objects; warnings name the others.

    Raises:
        FungraspError: none can be used; the message is the first reason, or ``none`` without items.
    """
    found: list[HumanGrasp] = []
    problem = None
    for item in items:
        try:
            new = guarded("sequence")(grasps)(item)
        except FungraspError as error:
            _log.warning("skipped %s: %s", item, error)
            problem = problem or error
        else:
            found += new if isinstance(new, list) else [new]
    if not found:
        raise problem or FungraspError(none)
    return found


def each_moved(
    poses: Mapping[str, np.ndarray], grasp: Callable[[str], HumanGrasp], where: str | Path
) -> list[HumanGrasp]:
    """Return the grasps of all objects that move. poses: by name, shape [T, 7] each."""
    moved = [name for name, track in poses.items() if len(moved_frames(track[:, :3]))]
    return each(moved, grasp, f"{where}: no object moves")


def data_object(folder: str | Path, name: str, mass: float | None = None) -> ResolvedObject:
    """Load an object of a data set from ``<name>.obj`` (.stl, .ply, .glb) or a mesh in the folder ``<name>``.

    Raises:
        FungraspError: there is no such mesh, or it is invalid.
    """
    files = mesh_files(folder)
    if name not in files:
        raise UnknownNameError("mesh", name, files)
    found = resolve_object(files[name].absolute(), mass)
    return replace(found, model=replace(found.model, name=name))


def subtable(path: Path, fields: Any, name: Any) -> Mapping[Any, Any]:
    """Return a field that contains fields.

    Raises:
        FungraspError: the field is missing or has another type.
    """
    value = fields.get(name) if isinstance(fields, Mapping) else None
    if not isinstance(value, Mapping):
        raise FungraspError(f"{path}: there is no field '{name}' of fields")
    return value


def numbers(path: Path, fields: Any, name: Any, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
    """Return a field of finite numbers.

    shape: required shape, with None for any size. None: any shape.

    Raises:
        FungraspError: the field is missing, or its type, shape or values differ.
    """
    try:
        array = np.asarray(fields[name] if isinstance(fields, Mapping) else "")
    except (KeyError, ValueError):
        array = np.asarray("")
    wanted = array.shape if shape is None else shape
    fits = len(wanted) == array.ndim and all(w in (None, s) for w, s in zip(wanted, array.shape, strict=True))
    if array.dtype.kind not in "fiu" or not fits:
        size = "" if shape is None else f" of shape {str(shape).replace('None', 'any')}"
        raise FungraspError(
            f"{path}: field '{name}' holds {array.dtype} of shape {array.shape}, expected numbers{size}"
        )
    if not np.isfinite(array).all():
        raise FungraspError(f"{path}: field '{name}' is not finite")
    return array.astype(float)
