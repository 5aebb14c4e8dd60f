"""Read and write grasp sets as ``.npz`` files (docs/file-format.md)."""

from __future__ import annotations

from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded, one_line
from fungrasp.core.formats.numpy_files import npz_names, read_npz
from fungrasp.grasps.diagnosis import checked_grasps
from fungrasp.grasps.grasp_set import BOUNDS, FILE_VERSION, GraspSet, given_bounds
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.robot_grasp import EXTRA, RobotGrasp, RobotGraspSet
from fungrasp.objects import ObjectModel, load_object, object_names

BUILTIN = "builtin"
"""Name of the built-in human grasps in place of a file."""

BUILTIN_PATH = Path(__file__).parent / "builtin" / "grasps.npz"

_KNOWN = {"version", "hand", "hand_file", "joint_names", *HumanGraspSet.FIELDS, *RobotGraspSet.FIELDS}
"""Names of all fields except ``extra`` values."""

Grasps = TypeVar("Grasps", bound=GraspSet[Any])


@guarded("grasp file")
def load_human_grasps(path: str | Path) -> HumanGraspSet:
    """Read human grasps from a file, or the built-in ones for "builtin".

    Raises:
        FungraspError: the file is missing, not a grasp file or invalid; the message names the field and row.
    """
    if str(path) == BUILTIN:
        return builtin_grasps()
    return _human(Path(path), read_grasp_fields(path))


@guarded("grasp file")
def load_robot_grasps(path: str | Path) -> RobotGraspSet:
    """Read robot grasps from a file.

    Raises:
        FungraspError: the file is missing, not a grasp file or invalid; the message names the field and row.
    """
    return _robot(Path(path), read_grasp_fields(path))


@guarded("grasp file")
def load_grasps(path: str | Path) -> HumanGraspSet | RobotGraspSet:
    """Read human or robot grasps from a file, or the built-in human grasps for "builtin".

    Raises:
        FungraspError: the file is missing, not a grasp file or invalid; the message names the field and row.
    """
    if str(path) == BUILTIN:
        return builtin_grasps()
    arrays = read_grasp_fields(path)
    return _robot(Path(path), arrays) if _is_robot(arrays) else _human(Path(path), arrays)


def builtin_grasps() -> HumanGraspSet:
    """Return the built-in human grasps.

    Raises:
        FungraspError: the installation does not contain them.
    """
    if not BUILTIN_PATH.is_file():
        raise FungraspError("this installation lacks the built-in human grasps; give a file of human grasps")
    return load_human_grasps(BUILTIN_PATH)


def save_human_grasps(path: str | Path, grasps: HumanGraspSet | HumanGrasp) -> None:
    """Write human grasps, as ``grasps.save`` does.

    Raises:
        FungraspError: the grasps are of another kind, there are none, or the file cannot be written.
    """
    _save(path, grasps, HumanGraspSet)


def save_robot_grasps(path: str | Path, grasps: RobotGraspSet | RobotGrasp) -> None:
    """Write robot grasps, as ``grasps.save`` does.

    Raises:
        FungraspError: see ``save_human_grasps``.
    """
    _save(path, grasps, RobotGraspSet)


def _save(path: str | Path, grasps: Any, kind: type[GraspSet[Any]]) -> None:
    if not isinstance(grasps, kind | kind.GRASP):
        raise FungraspError(
            f"expected a path, then a {kind.__name__}, not a {type(grasps).__name__}; {kind.__name__}.of "
            "makes one of single grasps"
        )
    grasps.save(path)


def _human(path: Path, arrays: Mapping[str, np.ndarray]) -> HumanGraspSet:
    if path == BUILTIN_PATH:
        return human_grasps(path, arrays)
    if _is_robot(arrays):
        human_grasps(path, arrays)
    _require_fields(path, HumanGraspSet, arrays, {"link_contacts", "object_rest_pose"})
    grasps = checked_grasps(arrays, _needed_objects(arrays), str(path), file=True)
    if not len(grasps):
        raise FungraspError(f"{path} holds no grasps")
    return grasps


def _needed_objects(arrays: Mapping[str, np.ndarray]) -> dict[str, ObjectModel]:
    """Load the built-in objects of grasps with missing contacts or rest poses."""
    contacts = arrays.get("link_contacts")
    lacking = contacts is None or contacts.ndim != 2 or not contacts.any(axis=1).all()
    names = arrays.get("object_name", np.zeros(0, dtype="U1"))
    if names.dtype.kind not in "US" or not (lacking or "object_rest_pose" not in arrays):
        return {}
    return {name: load_object(name) for name in set(names.astype(str).ravel().tolist()) & set(object_names())}


def _robot(path: Path, arrays: Mapping[str, np.ndarray]) -> RobotGraspSet:
    if not _is_robot(arrays) and "hand_joints" in arrays:
        raise FungraspError(
            f"{path} holds human grasps, robot grasps are needed here; 'fungrasp retarget' makes them"
        )
    whole: dict[str, Any] = {}
    for name, ndim in (("hand", 0), ("joint_names", 1), ("hand_file", 0)):
        value = arrays.get(name)
        if value is None and name == "hand_file":
            continue
        if value is None:
            raise FungraspError(f"{path}: field '{name}' is missing")
        if value.ndim != ndim or value.dtype.kind not in "US":
            expected = "one name" if ndim == 0 else "names of shape (M,)"
            raise FungraspError(
                f"{path}: field '{name}' holds {value.dtype} of shape {value.shape}, expected {expected}"
            )
        whole[name] = str(value) if ndim == 0 else tuple(value.astype(str))
    whole["extra"] = {
        name.removeprefix(EXTRA): value for name, value in arrays.items() if name.startswith(EXTRA)
    }
    return _build(path, RobotGraspSet, arrays, whole)


def _is_robot(arrays: Mapping[str, np.ndarray]) -> bool:
    return "hand" in arrays and "hand_joints" not in arrays


def _build(
    path: Path, kind: type[Grasps], arrays: Mapping[str, np.ndarray], whole: Mapping[str, Any]
) -> Grasps:
    _require_fields(path, kind, arrays)
    try:
        bounds = {"object_bounds": given_bounds(arrays)}
        grasps = kind(**whole, **bounds, **{name: arrays.get(name) for name in kind.FIELDS})
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error
    if not len(grasps):
        raise FungraspError(f"{path} holds no grasps")
    return grasps


def human_grasps(path: str | Path, arrays: Mapping[str, np.ndarray]) -> HumanGraspSet:
    """Create human grasps from the fields of a file, without checking their convention.

    Raises:
        FungraspError: the content is invalid; the message names the field and row.
    """
    if _is_robot(arrays):
        raise FungraspError(
            f"{path} holds robot grasps (of the hand '{arrays['hand']}'), human grasps are needed here"
        )
    return _build(Path(path), HumanGraspSet, arrays, {})


def _require_fields(
    path: Path, kind: type[GraspSet[Any]], arrays: Mapping[str, np.ndarray], computed: Set[str] = frozenset()
) -> None:
    needed = (name for name, field in kind.FIELDS.items() if not field.optional and name not in computed)
    missing = [name for name in needed if name not in arrays]
    if missing:
        found = ", ".join(sorted(npz_names(path, "grasp file"))) or "nothing"
        raise FungraspError(f"{path}: field '{missing[0]}' is missing; found: {found}")


def read_grasp_fields(path: str | Path) -> dict[str, np.ndarray]:
    """Return the fields of a grasp file by name, unchecked.

    Raises:
        FungraspError: the file is missing or cannot be read, or its version is not supported.
    """
    path = Path(path)
    arrays = read_npz(path, "grasp file", lambda name: name in _KNOWN or name.startswith((EXTRA, BOUNDS)))
    version = arrays.pop("version", np.array(FILE_VERSION))
    if version.ndim or version.dtype.kind not in "iu" or not 1 <= version <= FILE_VERSION:
        given = one_line(version, 60)
        raise FungraspError(
            f"{path} is of file version {given}, this fungrasp reads versions up to {FILE_VERSION}"
        )
    return {n: a.astype(str) if a.dtype.kind == "S" else a for n, a in arrays.items()}
