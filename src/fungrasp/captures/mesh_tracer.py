"""Ray tracing of coloured triangle meshes with Embree: what one camera sees, softly lit.

The steps, lights and sample patterns are those of ``render``, which draws MuJoCo models; here everything is a
mesh with a colour per vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.captures.painted_mesh import PaintedMesh
from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import rotation_matrix
from fungrasp.perception import Intrinsics
from fungrasp.rendering.light_sampling import asking, axes_along, disc, hemisphere, share
from fungrasp.rendering.shading import Look, linear, lit, soft_clip
from fungrasp.rendering.surfaces import dot, sample_image

NOTHING = -1
"""Thing that is seen where no ray meets anything."""

_CREASE = float(np.cos(np.radians(35.0)))
_LIFT = 3e-4
_SUN_REACH = 1.2
_DARKEST = 0.12
_EDGE_SAMPLES = 2


@dataclass(frozen=True)
class Thing:
    """Something to be seen."""

    mesh: PaintedMesh
    """World frame."""
    specular: float = 0.1
    """Strength of the highlight."""
    shininess: float = 10.0
    """Its exponent."""
    texture: np.ndarray | None = None
    """sRGB image that colours the mesh instead of its vertices, from 0 to 1, shape [H, W, 3]."""
    places: np.ndarray | None = None
    """Where the vertices are in the image, (u, v), shape [V, 2]."""


@dataclass(frozen=True)
class Traced:
    """What the camera sees."""

    light: np.ndarray
    """Linear light, shape [H, W, 3]."""
    depth: np.ndarray
    """Along the optical axis [m], 0 where nothing is seen, shape [H, W]."""
    thing: np.ndarray
    """Index of what is seen, or ``NOTHING``, shape [H, W]."""


@dataclass(frozen=True)
class _Points:
    distance: np.ndarray
    thing: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    direction: np.ndarray


class Tracer:
    """Things in the world, ready to be looked at."""

    def __init__(self, things: Sequence[Thing], look: Look):
        """
        Args:
            things: all there is to be seen.
            look: the light; its ``light`` must be given.

        Raises:
            FungraspError: Embree is not installed.
        """
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise FungraspError("rendering captures needs embreex: pip install embreex") from error
        self._things, self._look = things, look
        sun = np.asarray(look.light, dtype=float)
        self._sun = sun / np.linalg.norm(sun)
        self._scene: Any = EmbreeScene()
        for thing in things:
            mesh = thing.mesh
            TriangleMesh(self._scene, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))
        self._normals = [_corner_normals(thing.mesh) for thing in things]
        self._colours = [linear(thing.mesh.colours) for thing in things]
        self._specular = np.array([thing.specular for thing in things], np.float32)
        self._shininess = np.array([thing.shininess for thing in things], np.float32)

    def see(self, intrinsics: Intrinsics, pose_world_camera: np.ndarray, *, light: bool = True) -> Traced:
        """Look from a camera.

        Args:
            intrinsics: of the camera.
            pose_world_camera: shape [7].
            light: False leaves the picture black, which takes a tenth of the time.
        """
        rays = intrinsics.rays()
        shape = rays.shape[:2]
        rotation, eye = rotation_matrix(pose_world_camera[3:]), pose_world_camera[:3]
        length = np.linalg.norm(rays, axis=-1)
        directions = ((rays / length[..., None]) @ rotation.T).reshape(-1, 3).astype(np.float32)
        points = self._meet(eye, directions, colour=light)
        seen = points.thing >= 0
        depth = np.where(seen, points.distance, 0.0).reshape(shape) / length
        thing = points.thing.reshape(shape)
        if not light:
            return Traced(np.zeros((*shape, 3), np.float32), depth, thing)
        shadow, openness = self._receive(points, eye, shape)
        picture = self._shade(points, shadow, openness)
        edge = _edges(points, shape)
        inner = ((np.arange(_EDGE_SAMPLES) + 0.5) / _EDGE_SAMPLES - 0.5) / [[intrinsics.fx], [intrinsics.fy]]
        steps = np.stack(np.meshgrid(*inner), axis=-1).reshape(-1, 2)
        fine = np.repeat(rays.reshape(-1, 3)[edge], len(steps), axis=0)
        fine[:, :2] += np.tile(steps, (len(edge), 1))
        fine = (fine / np.linalg.norm(fine, axis=-1, keepdims=True)) @ rotation.T
        around = self._meet(eye, fine.astype(np.float32), colour=True)
        borrowed = _borrow(around, points, np.repeat(edge, len(steps)), shape)
        light_there = self._shade(around, shadow[borrowed], openness[borrowed])
        picture[edge] = light_there.reshape(len(edge), len(steps), 3).mean(1)
        return Traced(picture.reshape(*shape, 3), depth, thing)

    def _meet(self, eye: np.ndarray, directions: np.ndarray, *, colour: bool) -> _Points:
        origins = np.broadcast_to(eye.astype(np.float32), directions.shape).copy()
        hits = self._scene.run(origins, directions, query="INTERSECT", output=True)
        thing = hits["geomID"].astype(np.int64)
        distance = np.where(thing >= 0, hits["tfar"], np.inf)
        normal = np.zeros(directions.shape, np.float32)
        albedo = np.zeros(directions.shape, np.float32)
        if colour:
            weights = np.stack([1 - hits["u"] - hits["v"], hits["u"], hits["v"]], axis=-1)
            for i, surface in enumerate(self._things):
                rows = np.flatnonzero(thing == i)
                face, weight = hits["primID"][rows], weights[rows]
                normal[rows] = np.einsum("pc,pci->pi", weight, self._normals[i][face])
                corners = surface.mesh.faces[face]
                if surface.texture is not None and surface.places is not None:
                    place = np.einsum("pc,pci->pi", weight, surface.places[corners])
                    albedo[rows] = linear(sample_image(surface.texture, place))
                else:
                    albedo[rows] = np.einsum("pc,pci->pi", weight, self._colours[i][corners])
            normal /= np.maximum(np.sqrt(dot(normal, normal)), 1e-9)[:, None]
            normal = np.where(dot(normal, directions)[:, None] > 0, -normal, normal)
        return _Points(distance, thing, normal, albedo, directions)

    def _receive(
        self, points: _Points, eye: np.ndarray, shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """How much of the key light and of the surroundings reaches each pixel, shape [H * W] each."""
        look = self._look
        pixel = np.arange(len(points.thing))
        image = np.stack([pixel % shape[1], pixel // shape[1]], axis=-1)
        solid = points.thing >= 0
        asks = asking(shape[1], shape[0]) & solid
        shadow = np.ones(len(solid), np.float32)
        openness = shadow.copy()
        shaded = np.flatnonzero(asks & (points.normal @ self._sun > 0))
        across = axes_along(self._sun[None])[0, :, :2]
        lights = self._sun + look.light_spread * disc(image[shaded]) @ across.T
        lights /= np.sqrt(dot(lights, lights))[:, None]
        shadow[asks] = 0.0
        shadow[shaded] = self._reach(points, eye, shaded, lights, _SUN_REACH) >= 0.999 * _SUN_REACH
        occluded = np.flatnonzero(asks)
        around = axes_along(points.normal[occluded].astype(float))
        lights = np.einsum("pij,pj->pi", around, hemisphere(image[occluded]))
        reach = self._reach(points, eye, occluded, lights, look.occlusion_radius)
        openness[occluded] = _DARKEST + (1 - _DARKEST) * reach / look.occlusion_radius
        values = [shadow.reshape(shape), openness.reshape(shape)]
        surface = points.thing.reshape(shape)
        distance = points.distance.reshape(shape)
        shared = share(values, solid.reshape(shape), asks.reshape(shape), surface, distance)
        return shared[0].ravel(), shared[1].ravel()

    def _reach(
        self, points: _Points, eye: np.ndarray, rows: np.ndarray, directions: np.ndarray, limit: float
    ) -> np.ndarray:
        """How far light rays get [m], at most ``limit``, shape [R]."""
        origins = eye + points.distance[rows, None] * points.direction[rows] + _LIFT * points.normal[rows]
        limits = np.full(len(rows), limit, np.float32)
        return self._scene.run(
            origins.astype(np.float32), directions.astype(np.float32), query="DISTANCE", dists=limits
        )

    def _shade(self, points: _Points, shadow: np.ndarray, openness: np.ndarray) -> np.ndarray:
        result = np.zeros(points.normal.shape, np.float32)
        solid = np.flatnonzero(points.thing >= 0)
        thing = points.thing[solid]
        result[solid] = lit(
            self._look,
            points.albedo[solid],
            points.normal[solid],
            points.direction[solid],
            self._sun.astype(np.float32),
            shadow[solid],
            openness[solid],
            self._specular[thing],
            self._shininess[thing],
        )
        return soft_clip(result)


def _corner_normals(mesh: PaintedMesh) -> np.ndarray:
    """Unit normals at the triangles' corners, smooth except across creases, shape [T, 3, 3] float32."""
    corners = mesh.vertices[mesh.faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    vertex = np.stack(
        [
            np.bincount(mesh.faces.ravel(), np.repeat(weighted[:, k], 3), minlength=len(mesh.vertices))
            for k in range(3)
        ],
        axis=-1,
    )
    vertex /= np.maximum(np.linalg.norm(vertex, axis=-1, keepdims=True), 1e-300)
    flat = weighted / np.maximum(np.linalg.norm(weighted, axis=-1, keepdims=True), 1e-300)
    smooth = vertex[mesh.faces]
    soft = np.einsum("tci,ti->tc", smooth, flat) > _CREASE
    return np.where(soft[..., None], smooth, flat[:, None]).astype(np.float32)


def _edges(points: _Points, shape: tuple[int, int]) -> np.ndarray:
    """Pixels beside which something else begins, or a crease or a step of the same thing."""
    thing, normal = points.thing.reshape(shape), points.normal.reshape(*shape, 3)
    distance = np.where(np.isfinite(points.distance), points.distance, 0.0).reshape(shape)
    edge = np.zeros(shape, bool)
    for a, b in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        step = np.abs(distance[a] - distance[b]) > 0.03 * np.minimum(distance[a], distance[b])
        differs = (thing[a] != thing[b]) | step | (dot(normal[a], normal[b]) < 0.85)
        edge[a] |= differs
        edge[b] |= differs
    return np.flatnonzero(edge)


def _borrow(around: _Points, points: _Points, pixel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """For points near pixels, which neighbouring pixel sees the same thing at the nearest depth."""
    row, column = np.divmod(pixel, shape[1])
    best, gap = pixel.copy(), np.full(len(pixel), np.inf)
    for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
        other = np.clip(row + dy, 0, shape[0] - 1) * shape[1] + np.clip(column + dx, 0, shape[1] - 1)
        same = (points.thing[other] == around.thing) & (around.thing >= 0)
        apart = np.full(len(pixel), np.inf)
        apart[same] = np.abs(points.distance[other[same]] - around.distance[same]) + 1e-4 * (
            dx * dx + dy * dy
        )
        nearer = apart < gap
        best, gap = np.where(nearer, other, best), np.where(nearer, apart, gap)
    return best
