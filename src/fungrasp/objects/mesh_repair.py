"""Mending a surface that is not closed: winding, small holes, overlapping bodies, at last a shell."""

from __future__ import annotations

import manifold3d
import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

SHELL_THICKNESS = 0.002
"""Thickness of the shell that a surface beyond repair becomes [m]."""


def vertex_components(faces: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Connected surfaces of a mesh. faces: shape [F, 3]; count: number of vertices.

    Returns:
        the number of surfaces, and the surface of each vertex, shape [count].
    """
    ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_array((np.ones(len(ends[0])), ends), shape=(count, count))
    number, label = connected_components(links, directed=False)
    return number, label


def bodies(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The connected surfaces of a mesh, each a mesh of its own."""
    _, label = vertex_components(mesh.faces, len(mesh.vertices))
    of_face = label[mesh.faces[:, 0]]
    return [_submesh(mesh, of_face == body) for body in np.unique(of_face)]


def consistent_winding(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with faces flipped so that neighbours agree with the first face of each connected surface."""
    first, second = mesh.face_adjacency.T
    edges = mesh.face_adjacency_edges
    same_way = _runs_along(mesh.faces[first], edges) == _runs_along(mesh.faces[second], edges)
    count = len(mesh.faces)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count)).tocsr()
    disagree = coo_array((same_way.astype(float), (first, second)), shape=(count, count)).tocsr()
    disagree = disagree + disagree.T
    _, label = connected_components(graph, directed=False)
    flipped = np.zeros(count, dtype=bool)
    for start in np.unique(label, return_index=True)[1]:
        order, parent = breadth_first_order(graph, start, directed=False)
        for face in order[1:]:
            flipped[face] = flipped[parent[face]] ^ bool(disagree[face, parent[face]])
    faces = mesh.faces.copy()
    faces[flipped] = faces[flipped, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def fill_holes(mesh: trimesh.Trimesh, widest: float) -> tuple[trimesh.Trimesh, int]:
    """Close holes with a fan of triangles around their center.

    Args:
        mesh: with consistent winding.
        widest: holes wider than this [m] stay open.

    Returns:
        the mesh, and how many holes were closed.
    """
    vertices, faces, closed = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)], 0
    for loop in _holes(mesh.faces):
        corners = mesh.vertices[loop]
        if np.ptp(corners, axis=0).max() > widest:
            continue
        middle = len(mesh.vertices) + closed
        vertices.append(corners.mean(axis=0, keepdims=True))
        faces.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), middle)]))
        closed += 1
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False), closed


def unite(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """The union of a mesh's closed bodies; None if they don't overlap, or can't be united."""
    parts = bodies(mesh)
    if len(parts) < 2 or any(part.volume <= 0 for part in parts):
        return None
    solids = [solid(part) for part in parts]
    if any(each.status() != manifold3d.Error.NoError for each in solids):
        return None
    union = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    if union.volume() > mesh.volume * (1 - 1e-6):
        return None
    return _mesh(union)


def rebuild(mesh: trimesh.Trimesh, thickness: float = SHELL_THICKNESS) -> trimesh.Trimesh | None:
    """A closed surface around any triangles: the union of plates in their places, its cavities filled.

    Args:
        mesh: any triangles.
        thickness: of the plates [m].

    Returns:
        the mesh, or None if there is nothing to build from.
    """
    offsets = np.array(mesh.vertex_normals) * thickness / 2
    sides = np.stack([mesh.vertices - offsets, mesh.vertices + offsets])
    plates = [hull_solid(sides[:, face].reshape(-1, 3)) for face in mesh.faces]
    union = manifold3d.Manifold.batch_boolean(plates, manifold3d.OpType.Add)
    if union.is_empty():
        return None
    outer = [body for body in bodies(_mesh(union)) if body.volume > 0]
    filled = manifold3d.Manifold.batch_boolean([solid(body) for body in outer], manifold3d.OpType.Add)
    return None if filled.is_empty() else _mesh(filled.simplify(thickness / 20))


def _holes(faces: np.ndarray) -> list[np.ndarray]:
    """Vertex loops along the open edges, in the direction of the faces; no vertex is twice in one."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    present = {(int(a), int(b)) for a, b in edges}
    following: dict[int, list[int]] = {}
    for a, b in sorted(present):
        if (b, a) not in present:
            following.setdefault(a, []).append(b)
    loops = []
    while following:
        path = [next(iter(following))]
        while path and path[-1] in following:
            at = path[-1]
            path.append(following[at].pop())
            if not following[at]:
                del following[at]
            if path[-1] in path[:-1]:
                first = path.index(path[-1])
                loops.append(np.array(path[first:-1]))
                del path[first + 1 :]
    return loops


def _runs_along(triangles: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Whether each triangle, shape [N, 3], passes its edge, shape [N, 2], from first end to second."""
    starts = np.argmax(triangles == edges[:, :1], axis=1)
    following = np.take_along_axis(triangles, (starts[:, None] + 1) % 3, axis=1)[:, 0]
    return following == edges[:, 1]


def _submesh(mesh: trimesh.Trimesh, rows: np.ndarray) -> trimesh.Trimesh:
    used, renumbered = np.unique(mesh.faces[rows], return_inverse=True)
    return trimesh.Trimesh(mesh.vertices[used], renumbered.reshape(-1, 3), process=False)


def hull_solid(points: np.ndarray) -> manifold3d.Manifold:
    """The hull of points, shape [N, 3], for boolean operations; empty if they lie in a plane."""
    return manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=float))  # pyright: ignore[reportArgumentType]


def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    """A closed mesh for boolean operations; its ``status()`` says whether it is one."""
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.uint64))
    )


def _mesh(solid: manifold3d.Manifold) -> trimesh.Trimesh:
    mesh = solid.to_mesh64()
    return trimesh.Trimesh(
        mesh.vert_properties[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64), process=False
    )
