"""Reading a mesh file: checked, and repaired where that can be said in a sentence."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import trimesh

from fungrasp.errors import FungraspError

SUFFIXES = (".obj", ".stl", ".ply", ".glb")
"""File types looked up by an object's name, in this order."""

LARGEST = 1.0
"""Largest extent [m] that is taken for metres."""

TABLE = 1.5
"""Side of the table [m]; an object larger than it can't be tried."""

SMALLEST = 1e-3
"""Smallest extent [m] of an object's longest side."""

_log = logging.getLogger(__name__)


def load_mesh(path: str | Path, *, repair: bool = True) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Read a closed surface in metres.

    Args:
        path: any mesh trimesh reads; a scene's meshes are joined.
        repair: mend a surface that is not closed; else that is an error.

    Returns:
        vertices: [m], shape [V, 3] float64.
        faces: outward, shape [F, 3] int32.
        repairs: what was changed, one phrase each; also logged as a warning.

    Raises:
        FungraspError: the file is missing, unreadable, empty, not finite, not in metres, or can't be mended.
    """
    path = Path(path)
    mesh = _read(path)
    _check_size(path, mesh.extents)
    repairs: list[str] = []
    if not _closed(mesh):
        if not repair:
            raise FungraspError(f"{path}: the surface is not closed (holes or inconsistent winding)")
        mesh = _mend(path, mesh, repairs)
    if mesh.volume < 0:
        mesh.invert()
        repairs.append("turned the surface inside out (its faces pointed inwards)")
    for phrase in repairs:
        _log.warning("%s: %s", path, phrase)
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32), tuple(repairs)


def _read(path: Path) -> trimesh.Trimesh:
    if not path.is_file():
        raise FungraspError(f"the mesh file {path} does not exist")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
        raw = trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)
    except Exception as error:
        raise FungraspError(f"cannot read the mesh {path}: {' '.join(str(error).split()) or type(error).__name__}") from error
    if len(raw.faces) == 0:
        raise FungraspError(f"{path}: the mesh has no faces")
    if not np.isfinite(raw.vertices).all():
        row = int(np.flatnonzero(~np.isfinite(raw.vertices).all(axis=1))[0])
        raise FungraspError(f"{path}: vertex {row} is not finite")
    return trimesh.Trimesh(raw.vertices, raw.faces, process=True)


def _check_size(path: Path, extents: np.ndarray) -> None:
    size = float(np.max(extents))
    if size > LARGEST:
        if size > TABLE * 2 and size / 1000 >= SMALLEST:
            raise FungraspError(f"{path}: {size:.4g} m long; this looks like millimetres: scale the mesh by 0.001")
        raise FungraspError(f"{path}: {size:.4g} m long; an object must be smaller than {LARGEST:g} m")
    if size < SMALLEST:
        raise FungraspError(f"{path}: only {size:.3g} m long; meshes are in metres")


def _closed(mesh: trimesh.Trimesh) -> bool:
    return bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume != 0)


def _mend(path: Path, mesh: trimesh.Trimesh, repairs: list[str]) -> trimesh.Trimesh:
    if not mesh.is_watertight:
        mesh.fill_holes()
        repairs.append("filled holes")
    if not mesh.is_winding_consistent:
        mesh.fix_normals()
        repairs.append("made the winding of the faces consistent")
    if not _closed(mesh):
        raise FungraspError(f"{path}: the surface is not closed and can't be mended")
    return mesh
