"""Mesh files, read by trimesh in a limited child process."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import check_file, one_line
from fungrasp.core.formats.sandbox import run_limited

if TYPE_CHECKING:
    import trimesh

LARGEST = 400_000_000
"""Maximum size of a file [bytes]."""

MOST_FACES = 2_000_000
"""Maximum number of faces."""


def read_mesh(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the triangles of any mesh file that trimesh supports; meshes of a scene are joined.

    Returns:
        vertices: shape [V, 3] float64, finite.
        faces: vertex indices, shape [F, 3] int32, F >= 1.

    Raises:
        FungraspError: the file can't be read within the limits, has no or too many faces, or a vertex is not
            finite.
    """
    arrays = _arrays(path, "triangles")
    return arrays["vertices"], arrays["faces"]


def read_colored_mesh(path: str | Path) -> trimesh.Trimesh | None:
    """Read the triangles of a mesh file with its vertex colors, face colors or texture.

    Returns:
        The mesh, or None if the file has no colors.

    Raises:
        FungraspError: see ``read_mesh``; or the colors or the texture can't be read.
    """
    import trimesh
    from trimesh.visual import TextureVisuals

    arrays = _arrays(path, "colored triangles")
    vertices, faces = arrays["vertices"], arrays["faces"]
    if "vertex_colors" in arrays:
        return trimesh.Trimesh(vertices, faces, vertex_colors=arrays["vertex_colors"], process=False)
    if "face_colors" in arrays:
        return trimesh.Trimesh(vertices, faces, face_colors=arrays["face_colors"], process=False)
    if "texture" in arrays:
        image = Image.fromarray(arrays["texture"])
        visual = TextureVisuals(uv=arrays["uv"], image=image)
        return trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    return None


def is_colorless(path: str | Path) -> bool:
    """Return whether a mesh file evidently has no colors, without parsing it; False if that is unclear.

    Raises:
        FungraspError: the file can't be read.
    """
    path = check_file(path, "mesh file", LARGEST)
    suffix = path.suffix.lower()
    if suffix == ".obj":
        text = b"\n" + path.read_bytes()
        vertex = text[text.find(b"\nv ") :].lstrip().split(b"\n", 1)[0]
        # Colors follow the three coordinates, or are in material files or textures.
        return b"mtl" not in text and b"\nvt " not in text and len(vertex.split()) <= 4
    if suffix == ".ply":
        with path.open("rb") as stream:
            head, ended, _ = stream.read(10_000).partition(b"end_header")
        # Property names of colors, textures and texture coordinates.
        said = set(head.lower().split()) & {b"red", b"texturefile", b"texture_u", b"u", b"s"}
        return bool(ended) and not said
    return suffix == ".stl"


def _arrays(path: str | Path, job: str) -> dict[str, np.ndarray]:
    """Return the checked arrays of a ``sandbox_worker`` job on a mesh file."""
    path = check_file(path, "mesh file", LARGEST)
    with np.load(io.BytesIO(run_limited(job, path, "mesh", path.stat().st_size))) as file:
        arrays = dict(file)
    vertices, faces = arrays["vertices"], arrays["faces"]
    if len(faces) == 0:
        raise FungraspError(f"{one_line(path)}: the mesh has no faces")
    if len(faces) > MOST_FACES:
        raise FungraspError(
            f"{one_line(path)}: the mesh has {len(faces):,} faces; at most {MOST_FACES:,} are read: "
            "simplify it first"
        )
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise FungraspError(f"{one_line(path)}: vertex {int(np.argmax(bad))} is not finite")
    return arrays
