"""A known mesh prepared for pose estimation, and its depth images.

Camera frame: OpenCV (x right, y down, z forward) [m].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    rotation_matrix,
    transform_points,
)
from fungrasp.geometry.ray_casting import RayCaster
from fungrasp.geometry.signed_distance import SignedDistanceBank, nearest_on_mesh, points_on_triangles
from fungrasp.objects import ObjectModel
from fungrasp.objects.disk_cache import cached_on_disk

if TYPE_CHECKING:
    import trimesh

# Distance of rays that miss everything [m], and the distance beyond which a ray counts as a miss.
NOWHERE, BEYOND = 1e6, 1e3


class MeshRays:
    """A triangle mesh for ray casting in many poses."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        """
        Args:
            vertices: [m], shape [V, 3], mesh frame.
            faces: vertex indices, shape [F, 3].
        """
        self._caster = RayCaster([(vertices, faces)])
        low, high = np.min(vertices, axis=0), np.max(vertices, axis=0)
        self._middle, self._radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))

    def hits(
        self, poses: np.ndarray, directions: np.ndarray, stretch: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rays that meet the mesh in several poses.

        Args:
            poses: mesh in the camera frame, shape [H, 7].
            directions: rays from the camera's center, with z = 1, shape [R, 3].
            stretch: scale factors along the mesh's axes, about its origin, shape [H, 3].

        Returns:
            pose, ray and depth along the optical axis [m] of each hit, shape [N] each; poses ascending, depth
            float32.
        """
        # Importing Numba takes a fifth of a second.
        from fungrasp.geometry.compiling import plain
        from fungrasp.perception.compiled_loops import count_rays, local_rays

        factors = np.ones((len(poses), 3)) if stretch is None else stretch
        slopes = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        middles = poses[:, :3] + rotate(poses[:, 3:], factors * self._middle)
        radius = self._radius * factors.max(axis=1)
        # Smallest distance of the sphere's center along a ray that passes it.
        least = np.sqrt(np.maximum(np.square(middles).sum(axis=1) - np.square(radius), 0.0))
        # Rays in the frame of the unscaled mesh: lengths along them change, depths do not.
        axes = rotation_matrix(poses[:, 3:]) / factors[:, None, :]
        counts = np.empty(len(poses), np.int64)
        count_rays(slopes, middles, least, counts)
        pose, ray = np.empty((2, counts.sum()), np.int64)
        local = np.empty((len(pose), 3), np.float32)
        local_rays(slopes, middles, least, plain(directions), axes, pose, ray, local)
        lengths = np.sqrt(np.square(local).sum(axis=1))
        origins = -np.einsum("hi,hij->hj", poses[:, :3], axes).astype(np.float32)
        depth = self._caster.free_distance(origins[pose], local / lengths[:, None], NOWHERE) / lengths
        met = depth < BEYOND
        return pose[met], ray[met], depth[met]

    def cast(self, poses: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return depth images of the mesh in several poses [m], infinite at misses, shape [H, R], float32."""
        depth = np.full((len(poses), len(directions)), np.inf, np.float32)
        pose, ray, seen = self.hits(poses, directions)
        depth[pose, ray] = seen
        return depth


SAMPLES = 1000  # Number of surface samples.
KNOWN_FORMAT = 1  # Increases if the same mesh should give other samples or symmetries.
# Difference between channels, 0 to 1, below which colors are gray. A mesh with one gray is probably
# uncolored, as some programs write it.
GRAY = 0.03


@dataclass(frozen=True, eq=False)
class KnownSurface:
    """Signed distance and surface samples of a known object; object frame."""

    distance: SignedDistanceBank
    """Bank with the signed distance grid of the mesh."""
    samples: np.ndarray
    """Surface points, each far from those before: leading parts are evenly spread too [m], shape [M, 3]."""

    def distances(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Return distances of points from the surface [m], shape [P]. points: camera frame, shape [P, 3];
        pose: object in the camera frame, shape [7]."""
        local = inverse_transform_points(pose, points)
        return np.abs(self.distance.query(np.zeros(1, dtype=int), local[None])[0][0])


@dataclass(frozen=True, eq=False)
class ObjectTemplate:
    """A known mesh, prepared by ``object_template``."""

    surface: KnownSurface
    """Signed distance and surface samples."""
    normals: np.ndarray
    """Outward unit normals at the samples, shape [M, 3]."""
    rays: MeshRays
    """Mesh for ray casting."""
    size: float
    """Diagonal of the mesh's axis-aligned bounding box [m]."""
    middle: np.ndarray
    """Center of this box [m], object frame, shape [3]."""
    symmetries: np.ndarray
    """Poses, not the identity, that map the surface nearly onto itself, shape [S, 7]."""
    colors: np.ndarray | None
    """RGB at the samples, 0 to 1, shape [M, 3]; None if the mesh has no colors, or one gray."""


def object_template(mesh: ObjectModel | trimesh.Trimesh) -> ObjectTemplate:
    """Prepare a mesh [m]; results are cached.

    Raises:
        FungraspError: the mesh has no faces.
    """
    if not isinstance(mesh, ObjectModel):
        if len(mesh.faces) == 0:
            raise FungraspError("the object's mesh has no faces")
        model = _model(np.array(mesh.vertices, float).tobytes(), np.array(mesh.faces, np.int32).tobytes())
        return replace(_known(model), colors=_colors(mesh, _known(model).surface.samples))
    return _known(mesh)


@lru_cache(maxsize=16)
def _model(vertices: bytes, faces: bytes) -> ObjectModel:
    return ObjectModel(
        "mesh",
        1.0,
        np.frombuffer(vertices, dtype=float).reshape(-1, 3),
        np.frombuffer(faces, dtype=np.int32).reshape(-1, 3),
    )


@lru_cache(maxsize=16)
def _known(model: ObjectModel) -> ObjectTemplate:
    points, normals, symmetries = cached_on_disk(
        "known_object",
        f"{KNOWN_FORMAT} {SAMPLES} {model.mesh_digest}",
        _read_surface,
        lambda path: _write_surface(path, model.mesh),
    )
    return ObjectTemplate(
        KnownSurface(SignedDistanceBank([model.signed_distance]), points),
        normals,
        MeshRays(model.vertices, model.faces),
        float(np.linalg.norm(model.size)),
        0.5 * (model.vertices.min(axis=0) + model.vertices.max(axis=0)),
        symmetries,
        None,
    )


def _write_surface(path: Path, mesh: trimesh.Trimesh) -> None:
    points, normals = _even_samples(mesh, SAMPLES)
    with atomic_path(path) as temporary:
        np.savez(temporary, points=points, normals=normals, symmetries=_near_symmetries(points))


def _read_surface(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    data = read_npz(path, "surface samples")
    return data["points"], data["normals"], data["symmetries"]


def _near_symmetries(points: np.ndarray) -> np.ndarray:
    """Return rotations by multiples of 30 degrees about axes parallel to the principal axes that move the
    surface by less than 4 % of its size, shape [S, 7]. points: shape [M, 3].

    Axes are moved to where most of the surface maps onto itself: the axis of a mug's body is not at the
    center of the mug, because the handle is on one side.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    tree = KDTree(points)
    limit = 0.04 * float(np.linalg.norm(np.ptp(points, axis=0)))
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    angles = np.radians(np.arange(30, 360, 30))
    turns = quaternion_from_rotation_vector((axes[:, None] * angles[:, None]).reshape(-1, 3))
    poses = np.concatenate([middle - rotate(turns, middle), turns], axis=1)
    for _ in range(8):
        moved = transform_points(poses, points[:300])
        poses[:, :3] += np.median(points[tree.query(moved)[1]] - moved, axis=1)
    apart = tree.query(transform_points(poses, points[:300]))[0]
    return poses[np.mean(apart, axis=1) < limit]


def _colors(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray | None:
    """Return RGB at surface points, 0 to 1, shape [P, 3]; None if the mesh has no colors, or one gray."""
    import trimesh

    visual: Any = mesh.visual
    if visual is None:
        return None
    if visual.kind == "texture":
        visual = visual.to_color()
    if visual.kind not in ("vertex", "face"):
        return None
    nearest, faces = nearest_on_mesh(mesh, points)
    if visual.kind == "face":
        colors = np.asarray(visual.face_colors)[faces, :3] / 255.0
    else:
        parts = trimesh.triangles.points_to_barycentric(mesh.triangles[faces], nearest)
        corners = np.asarray(visual.vertex_colors)[mesh.faces[faces], :3] / 255.0
        colors = np.einsum("pc,pci->pi", parts, corners)
    plain = float(colors.std(axis=0).max()) < GRAY and float(np.ptp(colors.mean(axis=0))) < GRAY
    return None if plain else colors


def _even_samples(mesh: trimesh.Trimesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return surface points, each far from all before it, and normals, shape [count, 3] each."""
    gap = float(np.sqrt(mesh.area / (6 * count)))
    points, owners = points_on_triangles(np.asarray(mesh.triangles), gap)
    rng = np.random.default_rng(0)
    some = rng.permutation(len(points))[: 8 * count]
    points, owners = points[some], owners[some]
    chosen = np.zeros(min(count, len(points)), dtype=int)
    apart = np.full(len(points), np.inf)
    x, y, z = np.ascontiguousarray(points.T)
    for i in range(1, len(chosen)):
        last = chosen[i - 1]
        away = np.square(x - x[last]) + np.square(y - y[last]) + np.square(z - z[last])
        np.minimum(apart, away, out=apart)
        chosen[i] = apart.argmax()
    return points[chosen], np.asarray(mesh.face_normals)[owners[chosen]]


def even_rotations(count: int, rng: np.random.Generator) -> np.ndarray:
    """Return evenly spread rotations (super-Fibonacci spirals, Alexa, 2022), rotated at random, as
    quaternions wxyz, shape [count, 4]."""
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    a, b = 2 * np.pi * s / np.sqrt(2.0), 2 * np.pi * s / 1.533751168755204
    spiral = np.stack([inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)], axis=-1)
    turn = rng.normal(size=4)
    return quaternion_multiply(turn / np.linalg.norm(turn), spiral)


def starting_poses(known: ObjectTemplate, points: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """Return five poses per rotation, object in the camera frame, shape [5 H, 7].

    One position puts the center of the side that the camera would see at the center of the measured points.
    As a part of the object may be hidden, four others align a corner of the object's box in the view with
    that of the points, and the nearest depths.

    Args:
        points: measured points of the object [m], camera frame, shape [P, 3].
        quaternions: wxyz, shape [H, 4].
    """
    middle = points.mean(axis=0)
    axes = _view_axes(middle)
    rotation = axes @ rotation_matrix(quaternions)
    samples = known.surface.samples[:300]
    seen = np.maximum(-(rotation @ known.normals[:300].T)[:, 0], 0.0)
    turned = samples @ rotation.swapaxes(-1, -2)
    # Mean of the samples that face the camera, weighted by the cosine of the angle, shape [H, 3].
    side = np.einsum("hm,hmi->hi", seen, turned) / np.maximum(seen.sum(axis=1), 1e-9)[:, None]
    measured = points @ axes.T
    target = measured.mean(axis=0)
    centered = target - side
    low = np.percentile(measured, 2, axis=0) - turned.min(axis=1)
    high = np.percentile(measured, 98, axis=0) - turned.max(axis=1)
    depth = low[:, :1]
    positions = [
        centered,
        *(np.concatenate([depth, x[:, 1:2], y[:, 2:]], axis=1) for x in (low, high) for y in (low, high)),
    ]
    poses = [np.concatenate([position @ axes, quaternions], axis=1) for position in positions]
    return np.concatenate(poses)


def _view_axes(point: np.ndarray) -> np.ndarray:
    """Return unit vectors towards a point in front of the camera, right and down, as rows, shape [3, 3]."""
    forward = point / np.linalg.norm(point)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return np.stack([forward, right, np.cross(forward, right)])
