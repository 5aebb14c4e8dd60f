"""The colours of a mesh file on the surface that was made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import KDTree

from fungrasp.errors import FungraspError
from fungrasp.objects import ObjectModel


def coloured_mesh(path: str | Path, model: ObjectModel) -> trimesh.Trimesh | None:
    """The object with the colours of its mesh file, texture included.

    A mesh that had to be mended keeps its mended surface; each of its vertices takes the colour of the file's
    nearest one.

    Args:
        path: the file.
        model: what was made of it.

    Returns:
        None where the file has no colours.

    Raises:
        FungraspError: the file can't be read.
    """
    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        visual = mesh.visual
        if visual.kind == "texture" and visual.uv is None:
            return None
        if visual.kind not in ("texture", "vertex", "face"):
            return None
        if not model.repairs:
            return mesh
        colours = (visual.to_color() if visual.kind == "texture" else visual).vertex_colors
    except Exception as error:
        # trimesh fails in many ways on a texture that is missing or damaged.
        raise FungraspError(f"cannot read the colours of {path}: {' '.join(str(error).split())}") from error
    nearest = KDTree(np.asarray(mesh.vertices)).query(model.vertices)[1]
    return trimesh.Trimesh(
        model.vertices, model.faces, vertex_colors=np.asarray(colours)[nearest], process=False
    )
