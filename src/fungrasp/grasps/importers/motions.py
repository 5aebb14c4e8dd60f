"""Grasps from hands that move objects: what the importers of data sets share, for any other data set."""

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
"""How far an object has moved when it counts as grasped [m]."""

LARGEST = 1 << 28
"""Bytes of the largest text file of a sequence that is read."""

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
    """The grasp of the first frame with a hand in which the object has moved by more than ``MOVED``.

    Args:
        joints: of a right hand [m], shape [T, 21, 3], world frame; or a function of the frame's number, which
            gives None where the hand was not tracked.
        object_pose: of the object over time, shape [T, 7], same frame. It stands on the table at first: its
            lowest point then is the table's height.
        mesh: the object, as ``human_grasp`` takes it.
        order: of the joints, likewise.
        up: axis of the world that points up, one of ``grasps.conversion.UP``.
        task: what the grasp is for.

    Raises:
        FungraspError: the object never moves, the hand does not touch it when it moves, or the checks of
            ``human_grasp`` find something.
    """
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
    """Frames in which an object is more than ``MOVED`` from where it was first seen.

    positions: [m], shape [T, 3]; NaN where the object was not tracked.
    """
    tracked = np.flatnonzero(np.isfinite(positions[:, 0]))
    if not len(tracked):
        return tracked
    return np.flatnonzero(np.linalg.norm(positions - positions[tracked[0]], axis=1) > MOVED)


def each(
    items: Iterable[Item], grasps: Callable[[Item], HumanGrasp | list[HumanGrasp]], none: str
) -> list[HumanGrasp]:
    """The grasps of all sequences or objects that can be used; the others are named in warnings.

    Raises:
        FungraspError: none can be used: the first reason, or ``none`` if there is no reason.
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
    """The same of all objects that move, by their names and poses, shape [T, 7] each."""
    moved = [name for name, track in poses.items() if len(moved_frames(track[:, :3]))]
    return each(moved, grasp, f"{where}: no object moves")


def data_object(folder: str | Path, name: str, mass: float | None = None) -> ResolvedObject:
    """An object of a data set: its mesh is ``<name>.obj`` (.stl, .ply, .glb) in the folder, or in a folder
    ``<name>`` there.

    Raises:
        FungraspError: there is no such mesh, or a bad one.
    """
    files = mesh_files(folder)
    if name not in files:
        raise UnknownNameError("mesh", name, files)
    found = resolve_object(files[name].absolute(), mass)
    return replace(found, model=replace(found.model, name=name))


def subtable(path: Path, fields: Any, name: Any) -> Mapping[Any, Any]:
    """A field that holds fields.

    Raises:
        FungraspError: there is none.
    """
    value = fields.get(name) if isinstance(fields, Mapping) else None
    if not isinstance(value, Mapping):
        raise FungraspError(f"{path}: there is no field '{name}' of fields")
    return value


def numbers(path: Path, fields: Any, name: Any, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
    """A field of finite numbers.

    shape: that it must have, None for any size; any shape if None.

    Raises:
        FungraspError: it holds something else.
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
