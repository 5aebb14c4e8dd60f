"""Convex pieces of a mesh: CoACD, computed once and kept.

CoACD is not reproducible from run to run, so its pieces are published under a name made from the mesh and the
settings, and every later use, in any process, reads that file.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from fungrasp.files import atomic_path, cache_folder

FORMAT = 1
"""Goes up when the same mesh and settings should give different pieces."""


@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """One convex piece of an object."""

    vertices: np.ndarray
    """[m], shape [N, 3], object frame."""
    faces: np.ndarray
    """Triangles, outward, shape [M, 3] int32."""


@dataclass(frozen=True)
class DecompositionSettings:
    """Settings of CoACD; part of the name under which the pieces are kept."""

    threshold: float = 0.03
    """Concavity allowed in a piece, relative to the object's size."""
    max_pieces: int = 16
    """Most pieces."""
    max_vertices: int = 64
    """Most vertices of a piece."""
    search_iterations: int = 60
    """Iterations of the tree search for each cut."""
    seed: int = 0


def mesh_digest(vertices: np.ndarray, faces: np.ndarray) -> str:
    """SHA-256 of the vertices (float64) and faces (int32), hexadecimal."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(vertices, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(faces, dtype="<i4").tobytes())
    return digest.hexdigest()


def convex_pieces(
    vertices: np.ndarray, faces: np.ndarray, settings: DecompositionSettings | None = None
) -> tuple[ConvexPiece, ...]:
    """Convex pieces whose union is close to a watertight mesh; read from the cache when it has them.

    Args:
        vertices: [m], shape [V, 3].
        faces: shape [F, 3], integer.
        settings: of CoACD.

    Raises:
        FungraspError: the cache folder can't be written to.
    """
    settings = settings or DecompositionSettings()
    text = f"{FORMAT} {version('coacd')} {sorted(asdict(settings).items())} {mesh_digest(vertices, faces)}"
    path = cache_folder("convex_pieces") / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"
    pieces = _read(path)
    if pieces is None:
        with _locked(path.with_suffix(".lock")):
            pieces = _read(path)
            if pieces is None:
                _write(path, _decompose(vertices, faces, settings))
                pieces = _read(path)
    assert pieces is not None
    return pieces


def _decompose(vertices: np.ndarray, faces: np.ndarray, settings: DecompositionSettings) -> tuple[ConvexPiece, ...]:
    import coacd

    coacd.set_log_level("off")
    parts = coacd.run_coacd(
        coacd.Mesh(np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int32)),
        threshold=settings.threshold,
        max_convex_hull=settings.max_pieces,
        preprocess_mode="off",
        mcts_iterations=settings.search_iterations,
        decimate=True,
        max_ch_vertex=settings.max_vertices,
        seed=settings.seed,
    )
    return tuple(ConvexPiece(np.asarray(v, dtype=float), np.asarray(f, dtype=np.int32)) for v, f in parts)


def _write(path: Path, pieces: tuple[ConvexPiece, ...]) -> None:
    with atomic_path(path) as temporary:
        np.savez(
            temporary,
            vertices=np.concatenate([p.vertices for p in pieces]),
            faces=np.concatenate([p.faces for p in pieces]),
            vertex_counts=np.array([len(p.vertices) for p in pieces]),
            face_counts=np.array([len(p.faces) for p in pieces]),
        )


def _read(path: Path) -> tuple[ConvexPiece, ...] | None:
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            vertices = np.split(data["vertices"], np.cumsum(data["vertex_counts"])[:-1])
            faces = np.split(data["faces"], np.cumsum(data["face_counts"])[:-1])
    except (OSError, ValueError, KeyError, EOFError) as error:
        logging.getLogger(__name__).warning("the kept pieces %s are unreadable (%s): computing them again", path, error)
        return None
    return tuple(ConvexPiece(v, f) for v, f in zip(vertices, faces, strict=True))


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold ``path`` against other processes, where the system can (POSIX)."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
