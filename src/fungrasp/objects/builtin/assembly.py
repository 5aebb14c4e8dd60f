"""From convex solids with part names to one watertight mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import manifold3d
import numpy as np

from fungrasp.objects.builtin.shapes import Solid
from fungrasp.objects.convex import ConvexPiece, convex_hull

Parts = Mapping[str, Sequence[Solid]]
"""Convex solids by the name of the functional part they make up."""


def assemble(parts: Parts) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], tuple[ConvexPiece, ...]]:
    """Unite convex solids; the origin moves to the centre of the bounding box.

    Returns:
        vertices: [m], shape [V, 3] float64.
        faces: outward, shape [F, 3] int32.
        masks: faces of each part, shape [F] bool each; a face belongs to exactly one part.
        pieces: the solids.
    """
    names = [name for name, solids in parts.items() for _ in solids]
    hulls = [manifold3d.Manifold.hull_points(points).as_original() for solids in parts.values() for points in solids]
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    mesh = union.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3])
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    owner = {hull.original_id(): name for hull, name in zip(hulls, names, strict=True)}
    runs = np.diff(np.asarray(mesh.run_index, dtype=int)) // 3
    part_of_face = np.repeat([owner[int(i)] for i in mesh.run_original_id], runs)
    masks = {name: part_of_face == name for name in parts}
    pieces = tuple(convex_hull(points - center) for solids in parts.values() for points in solids)
    return vertices - center, np.asarray(mesh.tri_verts, dtype=np.int32), masks, pieces

