"""Convex pieces of a mesh: CoACD, computed once and cached on disk.

CoACD is not reproducible between runs. Its pieces are therefore stored under a key of mesh and settings, and
every later use, in any process, reads the same file.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from fungrasp.core.files import atomic_path
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.geometry.triangle_mesh import triangle_mesh
from fungrasp.objects.disk_cache import cached_on_disk
from fungrasp.objects.mesh_repair import hull_solid, solid

DECOMPOSITION_FORMAT = 1
"""Version of the cached pieces; increase it if the same mesh and settings should give different pieces."""


@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """One convex piece of an object."""

    vertices: np.ndarray
    """Vertices [m], shape [N, 3] float64, object frame."""
    faces: np.ndarray
    """Triangles, oriented outwards, shape [M, 3] int32."""


@dataclass(frozen=True)
class DecompositionSettings:
    """Settings of CoACD; part of the cache key.

    The search is smaller than CoACD's default: 3 times faster and equally accurate on 5 YCB meshes.
    """

    concavity: float = 0.005
    """Largest distance of a piece's hull from the mesh; other pieces are cut further [m]."""
    fine_concavity: float = 0.0025
    """The same for simple objects: those that need at most a third of ``max_pieces`` at ``concavity`` [m]."""
    max_pieces: int = 24
    """Largest number of pieces; beyond it, pieces are merged. Thin shells need many."""
    max_vertices: int = 128
    """Largest number of vertices of a piece. With 64, a ball of 10 cm is 2 mm too small and physics no
    faster."""
    tolerance: float = 0.0002
    """Largest shrinkage of a piece by leaving out vertices, and error of simplifying a large mesh [m]."""
    most_faces: int = 4000
    """Number of faces above which a mesh is first simplified to within ``tolerance``."""
    search_iterations: int = 30
    """Iterations of the tree search for each cut."""
    search_nodes: int = 10
    """Candidate planes per axis of the tree search."""
    search_depth: int = 2
    """Number of cuts that the tree search looks ahead."""
    samples: int = 1000
    """Number of surface samples for measuring concavity."""
    seed: int = 0
    """Seed of CoACD's random numbers."""


def convex_hull(points: np.ndarray) -> ConvexPiece:
    """Return the hull of points: [m], shape [N, 3], not all in one plane."""
    mesh = hull_solid(points).to_mesh64()
    return ConvexPiece(np.array(mesh.vert_properties[:, :3]), np.asarray(mesh.tri_verts, dtype=np.int32))


def mesh_digest(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Return the SHA-256 of vertices (float64) and faces (int32), hexadecimal."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(vertices, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(faces, dtype="<i4").tobytes())
    return digest.hexdigest()


def convex_pieces(
    vertices: np.ndarray, faces: np.ndarray, settings: DecompositionSettings | None = None
) -> tuple[ConvexPiece, ...]:
    """Return convex pieces whose union approximates a watertight mesh, from the cache if possible.

    Args:
        vertices: [m], shape [V, 3].
        faces: oriented outwards, shape [F, 3], integer.
        settings: defaults if None.

    Raises:
        FungraspError: the pieces can't be written.
    """
    chosen = settings or DecompositionSettings()
    options = sorted(asdict(chosen).items())
    key = f"{DECOMPOSITION_FORMAT} {version('coacd')} {options} {mesh_digest(vertices, faces)}"
    return cached_on_disk(
        "convex_pieces", key, _read, lambda path: _write(path, _decompose(vertices, faces, chosen))
    )


def fewer_points(points: np.ndarray, limit: int, tolerance: float) -> np.ndarray:
    """Select corners of a convex solid whose hull is nearly the same.

    Starts with the extreme points along the axes and adds the corner farthest outside, until none is farther
    outside than ``tolerance``.

    Args:
        points: [m], shape [N, 3].
        limit: largest number of points, at least 4.
        tolerance: [m].

    Returns:
        Corners [m], shape [K, 3], K <= limit.
    """
    corners = points[ConvexHull(points).vertices]
    chosen = list(dict.fromkeys([*np.argmax(corners, axis=0).tolist(), *np.argmin(corners, axis=0).tolist()]))
    while len(chosen) < min(limit, len(corners)):
        outside = _distance_outside(corners, chosen)
        furthest = int(np.argmax(outside))
        if outside[furthest] <= tolerance:
            break
        chosen.append(furthest)
    return corners[chosen]


def _distance_outside(corners: np.ndarray, chosen: list[int]) -> np.ndarray:
    """Return distances of corners beyond the chosen corners' hull (its face planes); over 1 if it is flat."""
    try:
        planes = ConvexHull(corners[chosen]).equations
    except QhullError:
        spread = corners - corners[chosen[0]]
        flat = np.linalg.svd(spread[chosen])[2][min(2, len(chosen) - 1) :]
        return np.where(
            np.isin(np.arange(len(corners)), chosen), 0.0, 1.0 + np.linalg.norm(spread @ flat.T, axis=1)
        )
    return (corners @ planes[:, :3].T + planes[:, 3]).max(axis=1)


def _decompose(
    vertices: np.ndarray, faces: np.ndarray, settings: DecompositionSettings
) -> tuple[ConvexPiece, ...]:
    if len(faces) > settings.most_faces:
        vertices, faces = _simplified(vertices, faces, settings.tolerance)
    hulls = _coacd(vertices, faces, settings, settings.concavity)
    if len(hulls) <= settings.max_pieces / 3:
        hulls = _coacd(vertices, faces, settings, settings.fine_concavity)
    return tuple(
        convex_hull(fewer_points(points, settings.max_vertices, settings.tolerance)) for points in hulls
    )


def _coacd(
    vertices: np.ndarray, faces: np.ndarray, settings: DecompositionSettings, concavity: float
) -> list[np.ndarray]:
    import coacd

    coacd.set_log_level("off")
    hulls = coacd.run_coacd(
        coacd.Mesh(np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int32)),
        threshold=concavity,
        real_metric=True,
        max_convex_hull=settings.max_pieces,
        preprocess_mode="off",
        resolution=settings.samples,
        mcts_nodes=settings.search_nodes,
        mcts_iterations=settings.search_iterations,
        mcts_max_depth=settings.search_depth,
        seed=settings.seed,
    )
    return [np.asarray(points, dtype=float) for points, _ in hulls]


def _simplified(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    given = triangle_mesh(vertices, faces)
    simple = solid(given).simplify(tolerance).to_mesh64()
    if len(simple.tri_verts) == 0:
        return vertices, faces
    return np.array(simple.vert_properties[:, :3]), np.asarray(simple.tri_verts, dtype=np.int32)


def _write(path: Path, pieces: tuple[ConvexPiece, ...]) -> None:
    with atomic_path(path) as temporary:
        np.savez(
            temporary,
            vertices=np.concatenate([p.vertices for p in pieces]),
            faces=np.concatenate([p.faces for p in pieces]),
            vertex_counts=np.array([len(p.vertices) for p in pieces]),
            face_counts=np.array([len(p.faces) for p in pieces]),
        )


def _read(path: Path) -> tuple[ConvexPiece, ...]:
    data = read_npz(path, "convex pieces")
    vertices = np.split(data["vertices"], np.cumsum(data["vertex_counts"])[:-1])
    faces = np.split(data["faces"], np.cumsum(data["face_counts"])[:-1])
    return tuple(ConvexPiece(v, f) for v, f in zip(vertices, faces, strict=True))
