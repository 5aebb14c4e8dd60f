"""A physical object: mesh, mass, parts, and derived quantities such as resting poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import digest
from fungrasp.core.formats.checks import is_plain_name
from fungrasp.geometry.signed_distance import SignedDistanceGrid, nearest_on_mesh
from fungrasp.geometry.triangle_mesh import (
    hull_triangles,
    normals_and_areas,
    triangle_mesh,
    volume_and_center,
)
from fungrasp.objects.convex_decomposition import ConvexPiece, convex_pieces, mesh_digest
from fungrasp.objects.disk_cache import cached_on_disk

if TYPE_CHECKING:
    import trimesh


GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]."""

GRID_SPACING = 0.0025
"""Edge of a cell of the signed-distance grid [m]."""

GRID_FORMAT = 2
"""Version of cached grids; increase it if the same mesh should give another grid."""


@dataclass(frozen=True, eq=False, repr=False)
class ObjectModel:
    """A physical object; see ``fungrasp.objects.load_object``."""

    name: str
    """Name of the object in grasps."""
    mass: float
    """Mass [kg]."""
    vertices: np.ndarray
    """Vertices of the surface [m], shape [V, 3] float64, object frame."""
    faces: np.ndarray
    """Triangles, oriented outwards, shape [F, 3] int32."""
    parts: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Faces of each functional part by name, shape [F] bool; empty for a user's mesh."""
    construction: tuple[ConvexPiece, ...] = ()
    """Convex solids that make up a built-in object; empty for a user's mesh."""
    repairs: tuple[str, ...] = ()
    """Repairs made when the mesh was read."""
    source: str = ""
    """Source of mass and size."""
    mirror_image: ObjectModel | None = None
    """The original object, if this is its reflection in the plane y = 0."""
    scaled_from: tuple[ObjectModel, float] | None = None
    """The original object and the factor, if this is a scaled object."""

    def __repr__(self) -> str:
        return f"<ObjectModel: {self.name!r}, {self.mass:g} kg, {len(self.faces)} triangles>"

    def __post_init__(self) -> None:
        if not is_plain_name(self.name):
            raise FungraspError(f"the name of an object must be a plain name, not {self.name!r}")
        if not (np.isfinite(self.mass) and self.mass > 0):
            raise FungraspError(
                f"object '{self.name}': the mass must be positive and finite, not {self.mass!r} kg"
            )

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The surface, with the density set to give the object's mass. Do not modify it."""
        mesh = triangle_mesh(self.vertices, self.faces)
        mesh.density = self.mass / mesh.volume
        return mesh

    @cached_property
    def pieces(self) -> tuple[ConvexPiece, ...]:
        """Convex pieces for physics: the solids of a built-in object, otherwise from CoACD, cached on
        disk."""
        if self.mirror_image is not None:
            reflect = np.array([1.0, -1.0, 1.0])
            pieces = self.mirror_image.pieces
            return tuple(ConvexPiece(p.vertices * reflect, p.faces[:, ::-1].copy()) for p in pieces)
        if self.scaled_from is not None:
            model, factor = self.scaled_from
            return tuple(ConvexPiece(factor * p.vertices, p.faces) for p in model.pieces)
        return self.construction or convex_pieces(self.vertices, self.faces)

    @cached_property
    def signed_distance(self) -> SignedDistanceGrid:
        """Distance to the surface on a grid, computed once and cached on disk."""
        if self.mirror_image is not None:
            return self.mirror_image.signed_distance.mirrored()
        if self.scaled_from is not None:
            model, factor = self.scaled_from
            return model.signed_distance.scaled(factor)
        return cached_on_disk(
            "signed_distance",
            f"{GRID_FORMAT} {GRID_SPACING} {self.mesh_digest}",
            SignedDistanceGrid.load,
            lambda path: SignedDistanceGrid.from_mesh(self.vertices, self.faces, GRID_SPACING).save(path),
        )

    @cached_property
    def center_of_mass(self) -> np.ndarray:
        """Center of mass [m], shape [3], object frame, at uniform density."""
        return volume_and_center(self.vertices[self.faces])[1]

    @cached_property
    def hull(self) -> np.ndarray:
        """Outward triangles of the convex hull [m], shape [F, 3, 3], object frame."""
        return hull_triangles(self.vertices)

    @cached_property
    def inertia(self) -> np.ndarray:
        """Inertia [kg m2], shape [3, 3], about the center of mass, axes of the object frame, at uniform
        density."""
        return np.array(self.mesh.moment_inertia)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lowest and highest corner of the mesh, object frame [m], shape [2, 3]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @cached_property
    def size(self) -> np.ndarray:
        """Extents along the axes of the object frame [m], shape [3]."""
        return np.ptp(self.vertices, axis=0)

    @cached_property
    def mesh_digest(self) -> str:
        """SHA-256 of the mesh, the key of its cached data."""
        return mesh_digest(self.vertices, self.faces)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of mesh, mass and parts."""
        return digest(self.mesh_digest, self.mass, self.parts)

    def rest_pose(self, yaw: float = 0.0) -> np.ndarray:
        """Return the pose on the table, world frame, shape [7]: origin above the world's, lowest vertex at
        z = 0.

        Args:
            yaw: rotation about the vertical [rad].
        """
        return np.array([0, 0, -self.vertices[:, 2].min(), np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])


def nearest_parts(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Return the name of the part at the nearest surface point, "" for objects without parts.

    Args:
        points: object frame [m], shape [P, 3].

    Returns:
        Names, shape [P] str.
    """
    names = np.full(len(points), "", dtype=object)
    if model.parts and len(points):
        face = nearest_on_mesh(model.mesh, points)[1]
        for name, mask in model.parts.items():
            names[mask[face]] = name
    return names.astype(str)


ALIKE = np.deg2rad(8.0)
"""Angle between faces of a hull below which they count as one: measured meshes are not flat [rad]."""

BROAD = 0.03
"""Smallest fraction of a hull's surface of broad faces: the end of a marker has 1 %, its side 20 %."""


def nearest_surface_points(
    objects: Sequence[ObjectModel], grid: np.ndarray, points: np.ndarray, which: np.ndarray
) -> np.ndarray:
    """Return nearest points on the objects' surfaces for some points; the other points are unchanged.

    Args:
        objects: O object models.
        grid: index of each grasp's object, shape [N].
        points: object frame [m], shape [N, P, 3].
        which: points to replace, shape [N, P] bool.
    """
    result = points.copy()
    for number, model in enumerate(objects):
        chosen = which & (grid == number)[:, None]
        if chosen.any():
            result[chosen] = nearest_on_mesh(model.mesh, points[chosen])[0]
    return result


def resting_directions(model: ObjectModel) -> np.ndarray:
    """Return downward unit normals of stable faces: faces of the convex hull below the center of mass.

    Returns:
        Normals, object frame, shape [R, 3].
    """
    triangles, center = model.hull, model.center_of_mass
    normals = normals_and_areas(triangles)[0]
    foot = center - normals * np.sum((center - triangles[:, 0]) * normals, axis=1, keepdims=True)
    inside = np.ones(len(triangles), dtype=bool)
    for corner in range(3):
        edge = triangles[:, (corner + 1) % 3] - triangles[:, corner]
        inside &= np.sum(np.cross(edge, foot - triangles[:, corner]) * normals, axis=1) >= -1e-9
    return normals[inside]


def settled_up(model: ObjectModel, up: np.ndarray) -> np.ndarray:
    """Return the table's normal after the object has settled from a pose with ``up`` up: that of the nearest
    stable face.

    Measured poses are off by a few degrees: without settling, a flat object would hover or sink on one side.

    Args:
        up: unit vector, object frame, shape [..., 3].
    """
    downs = resting_directions(model)
    return -downs[np.argmin(up @ downs.T, axis=-1)]


def broad_settled_up(model: ObjectModel, up: np.ndarray) -> np.ndarray:
    """Like ``settled_up``, but only for broad faces: together with faces of nearly the same direction, they
    are a considerable fraction of the convex hull, so that the object stands even on a slightly tilted table.

    Args:
        up: unit vector, object frame, shape [3].
    """
    normals, areas = normals_and_areas(model.hull)
    downs = resting_directions(model)
    alike = downs @ normals.T > np.cos(ALIKE)
    broad = alike @ areas >= BROAD * areas.sum()
    candidates = downs[broad] if broad.any() else downs
    return -candidates[np.argmin(candidates @ up)]
