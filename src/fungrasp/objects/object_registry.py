"""Finding objects by name: in a folder, ours, another package's (entry point ``fungrasp.objects``)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.objects.builtin_objects import BUILTINS, is_plain_shape, load_builtin, plain_shape
from fungrasp.objects.mesh_file import MESH_SUFFIXES, load_mesh
from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.object_variants import MIRRORED, mirrored_object

YCB_MESH = "textured_simple.obj"
"""The one of several meshes in an object's folder that is taken."""


def object_names() -> tuple[str, ...]:
    """Names of the built-in objects."""
    return tuple(BUILTINS)


@lru_cache(maxsize=256)
def builtin_object(name: str, mass: float | None = None) -> ObjectModel:
    """A built-in object.

    Args:
        name: one of ``object_names()``.
        mass: [kg]; its own if None.

    Raises:
        FungraspError: no such object, or a mass that is not positive.
    """
    if name not in BUILTINS:
        raise UnknownNameError("object", name, BUILTINS)
    return load_builtin(name, mass)


def load_object(name: str | Path, mass: float | None = None, folder: str | Path | None = None) -> ObjectModel:
    """By name: ``<name>.obj`` (.stl, .ply, .glb) in ``folder``, else built-in, else another package's;
    ``<name>_mirrored`` is the mirror image of one of them. A name like "box:60x28x30" is the shape itself.

    Args:
        name: of the mesh file without suffix, of a built-in object, or of a shape (``plain_shape``); or a
            ``Path``, of a mesh file (``object_from_file``). A string is never a path: names come from files.
        mass: [kg]; needed for a mesh or a shape, a built-in object has its own.

    Raises:
        FungraspError: no such folder or object, a bad mesh, or a missing or bad mass.
    """
    if isinstance(name, Path):
        return object_from_file(name, mass)
    files = mesh_files(folder)
    known = {**dict.fromkeys(BUILTINS), **files}
    if name not in known and name.endswith(MIRRORED):
        return mirrored_object(load_object(name.removesuffix(MIRRORED), mass, folder))
    if name not in known and is_plain_shape(name):
        if mass is None:
            raise FungraspError(f"object '{name}': a shape needs a mass [kg]")
        return plain_shape(name, float(mass))
    if name not in known:
        raise UnknownNameError("object", name, known)
    path = known[name]
    if path is None:
        return builtin_object(name, mass)
    return object_from_file(path, mass, name)


def mesh_files(folder: str | Path | None = None) -> dict[str, Path]:
    """Mesh file of every object that is one, by name: other packages' and, before those, the folder's. An
    object may also have a folder of its own there, with one mesh in it or ``textured_simple.obj`` (YCB).

    Raises:
        FungraspError: the folder does not exist.
    """
    packaged = {name: path for name, path in _packaged_meshes().items() if name not in BUILTINS}
    return packaged | (_meshes_in(Path(folder)) if folder is not None else {})


def object_from_file(path: str | Path, mass: float | None, name: str = "") -> ObjectModel:
    """An object from a mesh file; its name is the file's without suffix unless it is given.

    Raises:
        FungraspError: a bad mesh, or a missing or bad mass.
    """
    path = Path(path)
    if mass is None:
        raise FungraspError(f"object '{path.stem}': a mesh needs a mass [kg]")
    stamp = path.stat().st_mtime_ns if path.is_file() else 0
    return _from_file(path.absolute(), float(mass), stamp, name or path.stem)


@lru_cache(maxsize=256)
def _from_file(path: Path, mass: float, stamp: int, name: str) -> ObjectModel:
    vertices, faces, repairs = _mesh(path, stamp)
    return ObjectModel(name, mass, vertices, faces, repairs=repairs, source=str(path))


@lru_cache(maxsize=256)
def _mesh(path: Path, stamp: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    return load_mesh(path)


def _meshes_in(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        problem = "is a file: give the folder it lies in" if folder.exists() else "does not exist"
        raise FungraspError(f"the folder of objects {folder} {problem}")
    paths = sorted(folder.iterdir())
    found: dict[str, Path] = {}
    for path in paths:
        inside = {mesh.name: mesh for mesh in path.glob("*") if mesh.suffix.lower() in MESH_SUFFIXES}
        if len(inside) == 1 or YCB_MESH in inside:
            found[path.name] = inside.get(YCB_MESH) or next(iter(inside.values()))
    for suffix in reversed(MESH_SUFFIXES):
        found |= {path.stem: path for path in paths if path.suffix.lower() == suffix}
    return found


@cache
def _packaged_meshes() -> dict[str, Path]:
    files: dict[str, Path] = {}
    for entry in entry_points(group="fungrasp.objects"):
        files |= _meshes_in(Path(entry.load()()))
    return files


def check_objects(names: Iterable[str], objects: Mapping[str, ObjectModel]) -> None:
    """Complain about objects that are missing.

    Args:
        names: of the objects that are needed.
        objects: those that are given, by name.

    Raises:
        FungraspError: names the first that is missing, and those that are given.
    """
    if not isinstance(objects, Mapping):
        raise FungraspError(
            f"expected objects by name, as fungrasp.load_objects(grasps) gives, not {type(objects).__name__}"
        )
    missing = sorted({str(name) for name in names} - set(objects))
    if missing:
        given = ", ".join(sorted(objects)) or "none"
        raise FungraspError(
            f"the object '{missing[0]}' of the grasps is not given; given: {given}. "
            "fungrasp.load_objects(grasps) loads them"
        )
