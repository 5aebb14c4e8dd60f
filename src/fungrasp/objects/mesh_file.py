"""Reading, checking and repairing mesh files."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest
from fungrasp.core.formats.checks import check_file
from fungrasp.core.formats.mesh_file import LARGEST, read_mesh
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.objects.disk_cache import cached_on_disk
from fungrasp.objects.mesh_repair import consistent_winding, fill_holes, parted, rebuild, simplify, unite

if TYPE_CHECKING:
    import trimesh

MESH_FORMAT = 2
"""Version of cached surfaces; increase it if the same file should give another surface."""

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb")
"""File types of objects, in the order in which they are searched for an object's name."""

TABLE_SIDE = 1.5
"""Side of the table and largest length of an object [m]."""

SHORTEST_OBJECT = 1e-3
"""Smallest length of an object [m]."""

HELD = (0.02, 0.6)
"""Range of lengths of most objects that a hand holds [m]."""

TABLE_THICKNESS = 0.015
"""Largest thickness of a piece of the table in a scan [m]."""

TABLE_PIECE = 0.2
"""Smallest width of such a piece [m]."""

TABLE_LARGER = 3.0
"""Smallest ratio of the area of such a piece to that of the object on it."""

UNITS = {"dm": 0.1, "inches": 0.0254, "cm": 0.01, "mm": 0.001}
"""Meters per unit, for units that meshes may be in."""

APART = 0.02
"""Gap between bodies of a mesh beyond which they are separate objects [m]."""

MOST_FACES = 100_000
"""Number of faces above which a mesh is simplified."""

THINNEST = 1e-6
"""Ratio of volume to area of a closed surface below which it consists of loose triangles, each closed by
itself [m]."""

MOST_LAYERS = 10.0
"""Ratio of an open surface's area to that of its bounding box above which it cannot be an object."""

WIDEST_HOLE = 0.5
"""Width of the widest hole that is filled, as a fraction of the object's longest side."""

_log = logging.getLogger(__name__)


def load_mesh(path: str | Path, *, repair: bool = True) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Read a closed surface in meters.

    Args:
        path: file with one of ``MESH_SUFFIXES``; the meshes of a scene are joined.
        repair: repair surfaces that are not closed; otherwise they are an error.

    Returns:
        vertices: [m], shape [V, 3] float64.
        faces: oriented outwards, shape [F, 3] int32.
        repairs: one phrase per repair, also logged as a warning.

    Raises:
        FungraspError: the file is missing, unreadable, empty, not finite, not in meters, or can't be
            repaired.
    """
    path = Path(path)
    check_file(path, "mesh file", LARGEST)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise FungraspError(
            f"cannot read the mesh {path}: a mesh is a file {', '.join(MESH_SUFFIXES)}; export it as one"
        )
    # The surface depends only on this file. Reading it takes another process and trimesh, so it is cached.
    with path.open("rb") as stream:
        content = hashlib.file_digest(stream, "sha256").hexdigest()
    vertices, faces, repairs = cached_on_disk(
        "meshes",
        f"{MESH_FORMAT} {version('trimesh')} {path.suffix.lower()} {repair} {content}",
        _kept,
        lambda kept: _keep(kept, *_surface(path, *read_mesh(path), repair)),
    )
    for phrase in (*repairs, *mesh_doubts(vertices, faces)):
        _log.warning("%s: %s", path, phrase)
    return vertices, faces, repairs


def mend_mesh(
    vertices: np.ndarray, faces: np.ndarray, name: str = "the mesh"
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Make a closed surface in meters from arrays, like ``load_mesh``.

    Args:
        vertices: [m], shape [V, 3].
        faces: triangles, shape [F, 3] int.
        name: prefix of messages.
    """
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.isfinite(vertices).all():
        raise FungraspError(f"{name}: vertices must be finite numbers of shape (V, 3), not {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1:] != (3,) or faces.dtype.kind not in "iu" or not len(faces):
        raise FungraspError(f"{name}: faces must be indices of shape (F, 3), not {faces.shape} {faces.dtype}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FungraspError(f"{name}: faces refer to vertices that are not there")
    vertices, faces, repairs = cached_on_disk(
        "meshes",
        f"{MESH_FORMAT} {version('trimesh')} arrays {digest(vertices, faces)}",
        _kept,
        lambda kept: _keep(kept, *_surface(name, vertices, faces, True)),
    )
    for phrase in (*repairs, *mesh_doubts(vertices, faces)):
        _log.warning("%s: %s", name, phrase)
    return vertices, faces, repairs


def _keep(path: Path, vertices: np.ndarray, faces: np.ndarray, repairs: tuple[str, ...]) -> None:
    with atomic_path(path) as temporary:
        np.savez(temporary, vertices=vertices, faces=faces, repairs=np.array(repairs, dtype=str))


def _kept(path: Path) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    data = read_npz(path, "mesh")
    return data["vertices"], data["faces"], tuple(data["repairs"].tolist())


def _surface(
    path: Path | str, vertices: np.ndarray, faces: np.ndarray, repair: bool
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Compute the result of ``load_mesh`` for a mesh that is not cached."""
    mesh = _merged(path, vertices, faces)
    _check_size(path, float(np.max(mesh.extents)))
    repairs: list[str] = []
    if not _closed(mesh) or _volume(mesh) <= 0:
        if not repair:
            raise FungraspError(f"{path}: the surface is not closed, or its faces don't all point outwards")
        mesh = _mend(path, mesh, repairs)
    if len(mesh.faces) > MOST_FACES:
        before = len(mesh.faces)
        mesh, moved = simplify(mesh, MOST_FACES)
        if len(mesh.faces) > 2 * MOST_FACES:
            raise FungraspError(f"{path}: {before:,} faces that can't be made fewer: simplify the mesh first")
        # Without numbers of faces, so that the phrase is the same for many meshes.
        repairs.append(f"simplified; the surface moved by at most {moved * 1000:g} mm")
    gap = _gap(mesh)
    if gap > APART:
        repairs.append(f"separate bodies with {1e3 * gap:.0f} mm between them were taken as one object")
    united = unite(mesh) if repair else None
    if united is not None:
        mesh = united
        repairs.append("united bodies that overlap")
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int32), tuple(repairs)


def _merged(path: Path | str, vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    import trimesh

    merged = trimesh.Trimesh(vertices, faces, process=True)
    if not _closed(merged):
        # Files without shared vertices (.stl): where parts of a closed surface touch, more than two faces may
        # share an edge, or two faces all corners.
        apart = parted(merged)
        if apart is not None:
            return apart
    merged.update_faces(merged.nondegenerate_faces())
    merged.update_faces(merged.unique_faces())
    merged.remove_unreferenced_vertices()
    if len(merged.faces) == 0:
        raise FungraspError(f"{path}: the mesh has no face with an area")
    return merged


def _check_size(path: Path | str, length: float) -> None:
    if length > TABLE_SIDE:
        fitting = [
            f"{1e3 * length * size:.0f} mm if it is in {unit} (scale the mesh by {size:g})"
            for unit, size in UNITS.items()
            if HELD[0] <= length * size <= HELD[1]
        ]
        raise FungraspError(
            f"{path}: {length:.4g} m long, larger than the table ({TABLE_SIDE:g} m)"
            + (f"; it would be {', or '.join(fitting)}" if fitting else "")
        )
    if length < SHORTEST_OBJECT:
        raise FungraspError(f"{path}: only {length:.3g} m long; a mesh must be in meters")


def mesh_doubts(vertices: np.ndarray, faces: np.ndarray) -> Iterator[str]:
    """Yield warnings about properties that are rare for hand-held objects: an odd size, a piece of the table.

    Args:
        vertices: [m], shape [V, 3].
        faces: triangles, shape [F, 3] int.
    """
    length = float(np.ptp(vertices, axis=0).max())
    if not HELD[0] <= length <= HELD[1]:
        yield (
            f"it is {1e3 * length:.3g} mm long, and a hand holds things of {1e3 * HELD[0]:.0f} to "
            f"{1e3 * HELD[1]:.0f} mm: if that is not its size, scale it by its true length [m] / {length:.3g}"
        )
    normals = np.cross(*(np.diff(vertices[faces], axis=1).transpose(1, 0, 2)))
    areas = np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.linalg.eigh((normals / np.maximum(areas, 1e-12)).T @ normals)[1][:, 2]
    for normal in (up, -up):
        across = np.linalg.svd(normal[None])[2][1:]
        height, flat = vertices @ normal, vertices @ across.T
        height = height - height.min()
        plate, rest = flat[height < TABLE_THICKNESS], flat[height >= TABLE_THICKNESS]
        if not len(rest) or height.max() < 2 * TABLE_THICKNESS:
            continue
        sides = np.ptp(plate, axis=0)
        if sides.min() < TABLE_PIECE or np.prod(sides) < TABLE_LARGER * np.prod(np.ptp(rest, axis=0)):
            continue
        outside = ((flat < rest.min(axis=0)) | (flat > rest.max(axis=0))).any(axis=1)
        top = height[outside & (height < TABLE_THICKNESS)].max() + 1e-3 + (vertices @ normal).min()
        terms = zip(normal, "xyz", strict=True)
        plane = " + ".join(a if c > 0.9995 else f"{c:.3g} {a}" for c, a in terms if abs(c) > 1e-3)
        yield (
            f"a flat piece of {1e3 * sides[0]:.0f} x {1e3 * sides[1]:.0f} mm is much wider than the rest: if "
            f"it is the table, cut off all with {plane} < {top:.4f} m"
        )


def _gap(mesh: trimesh.Trimesh) -> float:
    """Return the widest gap between parts of a mesh along an axis of its frame [m]; 0 if there is none."""
    import trimesh

    groups = trimesh.graph.connected_components(
        mesh.face_adjacency, nodes=np.arange(len(mesh.faces)), min_len=4
    )
    triangles = np.asarray(mesh.triangles)
    boxes = np.array([[triangles[g].min(axis=(0, 1)), triangles[g].max(axis=(0, 1))] for g in groups])
    widest = 0.0
    for axis in range(3) if 1 < len(groups) < 1000 else ():
        low, high = boxes[np.argsort(boxes[:, 0, axis])][:, :, axis].T
        widest = max(widest, float((low[1:] - np.maximum.accumulate(high)[:-1]).max()))
    return widest


def _closed(mesh: trimesh.Trimesh) -> bool:
    return bool(mesh.is_watertight and mesh.is_winding_consistent)


def _volume(mesh: trimesh.Trimesh) -> float:
    """Return the volume of a closed mesh [m3], negative if its faces point inwards. trimesh warns if it is
    0."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


def _mend(path: Path | str, mesh: trimesh.Trimesh, repairs: list[str]) -> trimesh.Trimesh:
    if not mesh.is_winding_consistent:
        mesh = consistent_winding(mesh)
        repairs.append("made neighboring faces wind the same way")
    if not mesh.is_watertight:
        mesh, closed = fill_holes(mesh, WIDEST_HOLE * float(np.max(mesh.extents)))
        if closed:
            repairs.append(f"filled {closed} hole{'s' * (closed > 1)}")
    if not _closed(mesh) or abs(_volume(mesh)) < THINNEST * mesh.area:
        size = mesh.extents
        if mesh.area > MOST_LAYERS * 2 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]):
            length = float(np.max(size)) * 100
            raise FungraspError(
                f"{path}: loose triangles of {mesh.area:.3g} m2 within {length:.0f} cm are not a surface"
            )
        rebuilt = rebuild(mesh)
        if rebuilt is None:
            raise FungraspError(f"{path}: the surface is not closed and can't be mended")
        mesh, thickness = rebuilt
        repairs[:] = [
            f"rebuilt the open surface as a shell {thickness * 1000:.3g} mm thick, closed cavities filled"
        ]
    if _volume(mesh) < 0:
        mesh.invert()
        repairs.append("turned the faces outwards")
    if _volume(mesh) == 0:
        raise FungraspError(f"{path}: the surface encloses no volume")
    return mesh
