"""Repair of surfaces that are not closed: winding, small holes, overlapping bodies, and finally a shell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import manifold3d
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fungrasp.geometry.shell_from_triangles import shell_from_triangles
from fungrasp.geometry.triangle_mesh import triangle_mesh

if TYPE_CHECKING:
    import trimesh

SHELL_THICKNESS = 0.002
"""Smallest thickness of the shell built around a surface that cannot be repaired [m]; large ones get more."""

MOST_HOLES = 20_000
"""Number of holes above which a surface consists of loose triangles, and no hole is filled."""

MOST_BODIES = 1000
"""Number of closed bodies above which a mesh is not united."""

SMALLEST_TOLERANCE, LARGEST_TOLERANCE = 0.0001, 0.005
"""First tolerance of simplification, doubled in each step, and its upper bound [m]."""


def vertex_components(faces: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Find the connected surfaces of a mesh. faces: shape [F, 3]; count: number of vertices.

    Returns:
        number of surfaces, and surface of each vertex, shape [count].
    """
    ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_array((np.ones(len(ends[0])), ends), shape=(count, count))
    number, label = connected_components(links, directed=False)
    return number, label


def bodies(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Split a mesh into its connected surfaces."""
    number, label = vertex_components(mesh.faces, len(mesh.vertices))
    if number == 1:
        return [mesh]
    of_face = label[mesh.faces[:, 0]]
    order = np.argsort(of_face, kind="stable")
    starts = np.flatnonzero(np.diff(of_face[order])) + 1
    return [_submesh(mesh, rows) for rows in np.split(order, starts)]


def consistent_winding(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Flip faces so that neighbors agree with the first face of each connected surface."""
    first, second = mesh.face_adjacency.T
    edges = mesh.face_adjacency_edges
    same_way = _runs_along(mesh.faces[first], edges) == _runs_along(mesh.faces[second], edges)
    # Two nodes per face, original and flipped; neighbors are connected if they agree.
    count = len(mesh.faces)
    ends = (
        np.concatenate([first, first + count]),
        np.concatenate(
            [np.where(same_way, second + count, second), np.where(same_way, second, second + count)]
        ),
    )
    joined = coo_array((np.ones(len(ends[0])), ends), shape=(2 * count, 2 * count))
    label = connected_components(joined, directed=False)[1].reshape(2, count)
    # Choose each face's node in the component of the unflipped first face of its surface.
    _, leader = np.unique(label.min(axis=0), return_index=True)
    chosen = np.isin(label[0], label[0][leader])
    faces = mesh.faces.copy()
    faces[~chosen] = faces[~chosen, ::-1]
    return triangle_mesh(mesh.vertices, faces)


def fill_holes(mesh: trimesh.Trimesh, widest: float) -> tuple[trimesh.Trimesh, int]:
    """Close holes with a fan of triangles around their center.

    Args:
        mesh: consistently wound mesh.
        widest: width of the widest hole to close [m].

    Returns:
        mesh, and number of closed holes.
    """
    vertices, faces, closed = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)], 0
    loops = _holes(mesh.faces)
    for loop in loops if len(loops) <= MOST_HOLES else ():
        corners = mesh.vertices[loop]
        if np.ptp(corners, axis=0).max() > widest:
            continue
        middle = len(mesh.vertices) + closed
        vertices.append(corners.mean(axis=0, keepdims=True))
        faces.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), middle)]))
        closed += 1
    return triangle_mesh(np.concatenate(vertices), np.concatenate(faces)), closed


def unite(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """Return the union of a mesh's closed bodies; None if they do not overlap or can't be united."""
    parts = bodies(mesh)
    if not 2 <= len(parts) <= MOST_BODIES or any(part.volume <= 0 for part in parts):
        return None
    solids = [solid(part) for part in parts]
    if any(each.status() != manifold3d.Error.NoError for each in solids):
        return None
    union = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    if union.volume() > mesh.volume * (1 - 1e-6):
        return None
    return _mesh(union)


def parted(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """Return a closed surface in which touching parts have separate vertices; None if this does not close
    it."""
    if len(mesh.faces) == 0:
        return None
    found = solid(mesh)
    if found.status() != manifold3d.Error.NoError or found.volume() <= 0.0:
        return None
    return _mesh(found)


def rebuild(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float] | None:
    """Return a closed surface around any triangles, with filled cavities.

    Returns:
        mesh and thickness of the shell around the triangles [m], at least ``SHELL_THICKNESS``; or None if
        there is nothing to build from.
    """
    vertices, faces, thickness = shell_from_triangles(np.asarray(mesh.triangles), SHELL_THICKNESS)
    shell = solid(triangle_mesh(vertices, faces)).simplify(thickness / 20)
    return None if shell.is_empty() else (_mesh(shell), thickness)


def simplify(mesh: trimesh.Trimesh, most_faces: int) -> tuple[trimesh.Trimesh, float]:
    """Reduce the faces of a closed mesh.

    Args:
        mesh: closed mesh.
        most_faces: largest number of faces, if it can be reached with tolerances below ``LARGEST_TOLERANCE``.

    Returns:
        mesh, and bound on the displacement of its surface [m].
    """
    tolerance, moved = SMALLEST_TOLERANCE, 0.0
    shape = solid(mesh)
    while shape.num_tri() > most_faces and tolerance < LARGEST_TOLERANCE:
        shape = shape.simplify(tolerance)
        moved += tolerance
        tolerance *= 2
    return (_mesh(shape), moved) if 0 < shape.num_tri() < len(mesh.faces) else (mesh, 0.0)


def _holes(faces: np.ndarray) -> list[np.ndarray]:
    """Return vertex loops along open edges, in the direction of the faces; no loop has a vertex twice."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    count = int(faces.max()) + 1
    # Sorting is eight times faster than the hashing of np.setdiff1d for millions of edges.
    forth, back = np.sort(edges @ [count, 1]), np.sort(edges @ [1, count])
    nearest = back[np.minimum(np.searchsorted(back, forth), len(back) - 1)]
    once = np.append(True, np.diff(forth) > 0)
    following: dict[int, list[int]] = {}
    for a, b in np.stack(np.divmod(forth[once & (nearest != forth)], count), axis=1).tolist():
        following.setdefault(a, []).append(b)
    loops = []
    for start in list(following):
        while start in following:
            path = [start]
            place = {path[0]: 0}
            while path and path[-1] in following:
                at = path[-1]
                to = following[at].pop()
                if not following[at]:
                    del following[at]
                if to in place:
                    first = place[to]
                    loops.append(np.array(path[first:]))
                    for vertex in path[first + 1 :]:
                        del place[vertex]
                    del path[first + 1 :]
                else:
                    place[to] = len(path)
                    path.append(to)
    return loops


def _runs_along(triangles: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return whether each triangle, shape [N, 3], traverses its edge, shape [N, 2], from first to second
    end."""
    starts = np.argmax(triangles == edges[:, :1], axis=1)
    following = np.take_along_axis(triangles, (starts[:, None] + 1) % 3, axis=1)[:, 0]
    return following == edges[:, 1]


def _submesh(mesh: trimesh.Trimesh, rows: np.ndarray) -> trimesh.Trimesh:
    used, renumbered = np.unique(mesh.faces[rows], return_inverse=True)
    return triangle_mesh(mesh.vertices[used], renumbered.reshape(-1, 3))


def hull_solid(points: np.ndarray) -> manifold3d.Manifold:
    """Return the hull of points, shape [N, 3], for boolean operations; empty if they are in a plane."""
    return manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=float))  # pyright: ignore[reportArgumentType]


def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    """Convert a closed mesh for boolean operations; ``status()`` tells whether it is valid."""
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.uint64))
    )


def _mesh(solid: manifold3d.Manifold) -> trimesh.Trimesh:
    mesh = solid.to_mesh64()
    return triangle_mesh(mesh.vert_properties[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64))
