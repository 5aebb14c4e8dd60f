"""Fit capsules and boxes to surfaces, and simplify surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import mujoco
import numpy as np
import trimesh
from scipy.optimize import least_squares

from fungrasp.geometry.shell_from_triangles import shell_from_triangles
from fungrasp.geometry.signed_distance import points_on_triangles

SAMPLE_GAP = 0.003
"""Smallest distance between sampled points of a surface [m]."""

MAX_SAMPLES = 1500
"""Approximate largest number of points to which a shape is fitted."""

FULL_ENOUGH = 0.8
"""A box is not divided if the convex hull of its points fills more than this share."""

MAX_BOXES = 4
"""Largest number of boxes for one mesh."""


@dataclass(frozen=True)
class Capsule:
    """All points within ``radius`` of a segment."""

    start: np.ndarray
    """Start of the segment [m], shape [3]."""
    end: np.ndarray
    """End of the segment [m], shape [3]."""
    radius: float
    """Radius [m]."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points, shape [P, 3], from the surface [m], shape [P]."""
        along = self.end - self.start
        part = np.clip((points - self.start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        return np.linalg.norm(points - self.start - part[:, None] * along, axis=1) - self.radius


@dataclass(frozen=True)
class Box:
    """A box with any orientation."""

    center: np.ndarray
    """Center [m], shape [3]."""
    half: np.ndarray
    """Half edges [m], shape [3]."""
    rotation: np.ndarray
    """Axes as columns, shape [3, 3]."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points, shape [P, 3], from the surface [m], shape [P]."""
        beyond = np.abs((points - self.center) @ self.rotation) - self.half
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return outside + np.minimum(beyond.max(axis=1), 0.0)


def mesh_points(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sample a surface evenly [m], shape [P, 3], P at most about twice ``MAX_SAMPLES``."""
    triangles = vertices[faces]
    area = (
        0.5
        * np.linalg.norm(
            np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
        ).sum()
    )
    gap = max(SAMPLE_GAP, float(np.sqrt(area / MAX_SAMPLES)), float(np.ptp(vertices, axis=0).max()) / 1000)
    points = points_on_triangles(triangles, gap)[0] if len(faces) else vertices
    _, first = np.unique(np.round(points / gap).astype(int), axis=0, return_index=True)
    points = points[first]
    return points[:: max(1, len(points) // MAX_SAMPLES)]


def primitive_mesh(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface of a primitive geom: vertices, body frame [m], shape [V, 3], and faces."""
    size, kinds = model.geom_size[geom], mujoco.mjtGeom
    kind = model.geom_type[geom]
    if kind == kinds.mjGEOM_BOX:
        mesh = trimesh.creation.box(2 * size)
    elif kind == kinds.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=24)
    elif kind == kinds.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[16, 16])
        mesh.apply_translation([0, 0, -float(mesh.bounds.mean(axis=0)[2])])
    else:
        mesh = trimesh.creation.icosphere(subdivisions=2)
        mesh.apply_scale(size if kind == kinds.mjGEOM_ELLIPSOID else [size[0]] * 3)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    vertices = np.asarray(mesh.vertices) @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    return vertices, np.asarray(mesh.faces)


def fit_capsule(points: np.ndarray, along: np.ndarray) -> Capsule:
    """Fit a capsule to points of a surface by robust least squares of their distances.

    Args:
        points: points of the surface [m], shape [P, 3].
        along: first guess of the capsule's direction, shape [3].
    """
    along = along / np.linalg.norm(along)
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    # Starts from the given direction and from the direction of largest extent.
    _, _, rows = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    low, high = points.min(axis=0) - 1e-3, points.max(axis=0) + 1e-3
    bounds = [*low, *low, 1e-3], [*high, *high, 0.5 * float(np.linalg.norm(high - low))]
    best, lowest = None, np.inf
    for direction in (along, rows[0]):
        t = (points - center) @ direction
        across = points - center - t[:, None] * direction
        radius = float(np.median(np.linalg.norm(across - np.median(across, axis=0), axis=1)))
        middle, half = 0.5 * (t.min() + t.max()), max(0.5 * float(np.ptp(t)) - radius, 1e-4)
        first = center + np.median(across, axis=0) + (middle - half) * direction
        last = first + 2 * half * direction

        def residual(x: np.ndarray) -> np.ndarray:
            return Capsule(x[:3], x[3:6], x[6]).distance(points) / 1e-3

        start = np.clip(np.concatenate([first, last, [radius]]), *bounds)
        found = least_squares(residual, start, loss="soft_l1", max_nfev=60, bounds=bounds)
        if found.cost < lowest:
            best, lowest = Capsule(found.x[:3], found.x[3:6], float(found.x[6])), found.cost
    assert best is not None
    return best


def fit_boxes(vertices: np.ndarray, faces: np.ndarray, rotation: np.ndarray) -> list[Box]:
    """Cover a mesh with boxes. Boxes are halved at their longest edge until they are full enough.

    Args:
        vertices: vertices [m], shape [V, 3].
        faces: indices of vertices, shape [F, 3].
        rotation: axes of the boxes as columns, shape [3, 3].
    """
    parts = [mesh_points(vertices, faces) @ rotation]
    done: list[np.ndarray] = []
    while parts:
        part = parts.pop(0)
        low, high = part.min(axis=0), part.max(axis=0)
        if len(parts) + len(done) + 2 > MAX_BOXES or len(part) < 40 or _fill(part) > FULL_ENOUGH:
            done.append(part)
            continue
        axis = int(np.argmax(high - low))
        upper = part[:, axis] > 0.5 * (low + high)[axis]
        parts += [part[~upper], part[upper]]
    boxes = []
    for part in done:
        low, high = part.min(axis=0), part.max(axis=0)
        half = np.maximum(0.5 * (high - low), 1e-3)
        boxes.append(Box(rotation @ (0.5 * (low + high)), half, rotation))
    return boxes


def _fill(points: np.ndarray) -> float:
    """Return the ratio of the convex hull's volume to that of the bounding box; 1 for flat points."""
    edges = np.ptp(points, axis=0)
    if edges.min() < 1e-3:
        return 1.0
    return float(trimesh.convex.convex_hull(points).volume / np.prod(edges))


MAX_FACES = 4000
"""Number of faces beyond which a visual mesh is simplified."""

FIRST_TOLERANCE, LAST_TOLERANCE = 1e-4, 5e-3
"""Tolerances of the first and last simplification [m]."""

SHELL = 2e-3
"""Thickness of the shell that replaces an open surface [m]."""


def coarse(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Simplify a surface to about ``MAX_FACES`` without opening it. Return vertices and faces.

    Args:
        vertices: vertices [m], shape [V, 3].
        faces: indices of vertices, shape [F, 3].
    """
    if len(faces) <= MAX_FACES:
        return vertices, faces
    # Some formats repeat shared vertices.
    places, which = np.unique(np.round(vertices, 7), axis=0, return_inverse=True)
    corners = which.reshape(-1)[faces]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    solid = _solid(places, corners[whole])
    if solid.status() != manifold3d.Error.NoError:
        solid = _solid(*shell_from_triangles(vertices[faces], SHELL)[:2])
    tolerance = FIRST_TOLERANCE
    while solid.num_tri() > MAX_FACES and tolerance < LAST_TOLERANCE:
        solid = solid.simplify(tolerance)
        tolerance *= 1.5
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(int)


def _solid(vertices: np.ndarray, faces: np.ndarray) -> manifold3d.Manifold:
    return manifold3d.Manifold(manifold3d.Mesh64(vertices.astype(float), faces.astype(np.uint64)))
