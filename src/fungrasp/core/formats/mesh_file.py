"""Mesh files, read by trimesh in a child process with limits."""

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
"""Bytes of the largest file that is read."""

MOST_FACES = 2_000_000
"""Faces of the largest mesh that is read."""


def read_mesh(path: str | Path, what: str = "mesh") -> tuple[np.ndarray, np.ndarray]:
    """The triangles of any mesh file that trimesh reads; a scene's meshes are joined.

    Returns:
        vertices: shape [V, 3] float64, finite.
        faces: vertex indices, shape [F, 3] int32, F >= 1.

    Raises:
        FungraspError: it can't be read in the time and memory there is, has no faces, too many, or a vertex
            that is not finite.
    """
    arrays = _arrays(path, what, "triangles")
    return arrays["vertices"], arrays["faces"]


def read_colored_mesh(path: str | Path, what: str = "mesh") -> trimesh.Trimesh | None:
    """The triangles of a mesh file with its colors, of vertices or faces or in a texture.

    Returns:
        None where the file has no colors.

    Raises:
        FungraspError: see ``read_mesh``; or the colors or the texture can't be read.
    """
    import trimesh
    from trimesh.visual import TextureVisuals

    arrays = _arrays(path, what, "colored triangles")
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
    """Whether a mesh file says at first glance that it has no colors; False where that takes reading it.

    Raises:
        FungraspError: the file can't be read.
    """
    path = check_file(path, "mesh file", LARGEST)
    suffix = path.suffix.lower()
    if suffix == ".obj":
        text = b"\n" + path.read_bytes()
        vertex = text[text.find(b"\nv ") :].lstrip().split(b"\n", 1)[0]
        # Colors follow the three coordinates; others are in files of materials, or in textures.
        return b"mtl" not in text and b"\nvt " not in text and len(vertex.split()) <= 4
    if suffix == ".ply":
        with path.open("rb") as stream:
            head, ended, _ = stream.read(10_000).partition(b"end_header")
        # Names of colors, textures and places in them.
        said = set(head.lower().split()) & {b"red", b"texturefile", b"texture_u", b"u", b"s"}
        return bool(ended) and not said
    return suffix == ".stl"


def _arrays(path: str | Path, what: str, job: str) -> dict[str, np.ndarray]:
    """What a job of ``sandbox_worker`` finds in a mesh file, checked."""
    path = check_file(path, f"{what} file", LARGEST)
    with np.load(io.BytesIO(run_limited(job, path, what, path.stat().st_size))) as file:
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
