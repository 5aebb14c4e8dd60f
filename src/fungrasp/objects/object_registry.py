"""Objects by name: from a folder, built-in, or from other packages (entry point ``fungrasp.objects``)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.geometry.triangle_mesh import volume_and_center
from fungrasp.objects.builtin_objects import BUILTINS, is_plain_shape, load_builtin, plain_shape
from fungrasp.objects.mesh_file import MESH_SUFFIXES, load_mesh
from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.object_variants import MIRRORED, mirrored_object

YCB_MESH = "textured_simple.obj"
"""The mesh to use if an object's folder has several."""


def object_names() -> tuple[str, ...]:
    """Return the names of the built-in objects."""
    return tuple(BUILTINS)


@lru_cache(maxsize=256)
def builtin_object(name: str, mass: float | None = None) -> ObjectModel:
    """Load a built-in object.

    Args:
        name: one of ``object_names()``.
        mass: [kg]; the object's own if None.

    Raises:
        FungraspError: the object is unknown, or the mass is not positive.
    """
    if name not in BUILTINS:
        raise UnknownNameError("object", name, BUILTINS)
    return load_builtin(name, mass)


def load_object(name: str | Path, mass: float | None = None, folder: str | Path | None = None) -> ObjectModel:
    """Load an object by name: ``<name>.obj`` (.stl, .ply, .glb) in ``folder``, else built-in, else from
    another package. ``<name>_mirrored`` is its mirror image. "box:60x28x30" is a plain shape.

    Args:
        name: name of a mesh file without suffix, a built-in object or a shape (``plain_shape``). A ``Path``
            is a mesh file (``object_from_file``); a string is never a path, because names come from files.
        mass: [kg]; required for a mesh or a shape.

    Raises:
        FungraspError: a folder or object is unknown, a mesh is invalid, or a mass is missing or invalid.
    """
    if isinstance(name, Path):
        return object_from_file(name, mass)
    if isinstance(mass, str | Path):
        raise FungraspError(f"the second argument is the mass [kg], not '{mass}': give the folder as folder=")
    files = mesh_files(folder)
    known = {**dict.fromkeys(BUILTINS), **files}
    if name not in known and name.endswith(MIRRORED):
        return mirrored_object(load_object(name.removesuffix(MIRRORED), mass, folder))
    if name not in known and is_plain_shape(name):
        if mass is None:
            raise FungraspError(f"object '{name}': a shape needs a mass [kg]")
        return plain_shape(name, float(mass))
    if name not in known:
        remedy = "In Python, fungrasp.object_from_mesh(path, mass) reads a mesh file."
        raise UnknownNameError("object", name, known, remedy if Path(name).suffix in MESH_SUFFIXES else "")
    path = known[name]
    if path is None:
        return builtin_object(name, mass)
    return object_from_file(path, mass, name)


DENSEST = 22_600.0
"""Density of osmium, the densest there is [kg/m^3]."""


def check_density(model: ObjectModel) -> None:
    """
    Raises:
        FungraspError: nothing of that size has the object's mass.
    """
    density = model.mass / volume_and_center(model.hull)[0]
    if density > DENSEST:
        raise FungraspError(
            f"'{model.name}': {model.mass:g} kg at this size is {density:,.0f} kg/m3, denser than any "
            f"material ({DENSEST:,.0f}): is the mass in grams?"
        )


def mesh_files(folder: str | Path | None = None) -> dict[str, Path]:
    """Return mesh files by object name, from the folder and from other packages. An object may have its own
    subfolder with a single mesh, or with ``textured_simple.obj`` (YCB).

    Raises:
        FungraspError: the folder does not exist.
    """
    packaged = {name: path for name, path in _packaged_meshes().items() if name not in BUILTINS}
    return packaged | (_meshes_in(Path(folder)) if folder is not None else {})


def object_from_file(path: str | Path, mass: float | None, name: str = "") -> ObjectModel:
    """Load an object from a mesh file. Default name: the file name without suffix.

    Raises:
        FungraspError: the mesh is invalid, or the mass is missing or invalid.
    """
    path = Path(path)
    if mass is None:
        raise FungraspError(f"object '{path.stem}': a mesh needs a mass [kg]")
    # Unlike Path.is_file it takes a path of any length.
    stamp = path.stat().st_mtime_ns if os.path.isfile(path) else 0  # noqa: PTH113
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
    """Check that all objects are given.

    Args:
        names: names of the required objects.
        objects: given objects, by name.

    Raises:
        FungraspError: an object is missing.
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
