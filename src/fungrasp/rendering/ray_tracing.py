"""Ray tracing of surfaces: what a camera sees, softly lit and anti-aliased.

The steps of an image: rays through the pixels' centers; the table top in closed form; a shadow ray and an
occlusion ray from every second pixel, whose results are averaged over its neighbors; shading; more rays
through the pixels on edges, lit as the pixels around them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.ray_casting import RayCaster
from fungrasp.rendering.light_sampling import (
    average_over_neighbors,
    axes_along,
    disc_sample,
    hemisphere_sample,
    sampled_pixels,
)
from fungrasp.rendering.shading import (
    Look,
    backdrop,
    dot,
    linear,
    lit,
    lit_table,
    soft_clip,
    table_fade,
    table_top,
)
from fungrasp.rendering.surfaces import SurfaceMesh

NOTHING, TABLE = -1, -2
"""Values of a segmentation where no surface is seen."""

SHADOW_REACH = 1.2
"""What is farther towards the key light throws no shadow [m]: the walls of a room have none."""

DARKEST = 0.12
"""Part of the light of the surroundings that reaches the narrowest corner."""

_LIFT = 3e-4
_TIE = 1e-4
_SPREAD = 12.0


@dataclass(frozen=True)
class PixelRays:
    """What the ray tracer needs to know of a camera."""

    width: int
    """Image width [pixels]."""
    height: int
    """Image height [pixels]."""
    eye: np.ndarray
    """Where the rays begin [m], world frame, shape [3]."""
    focal: float
    """Focal length [pixels]."""
    directions: Callable[[np.ndarray], np.ndarray]
    """Function from image points (u, v), shape [..., 2], to unit view directions, world frame, shape
    [..., 3]."""


@dataclass(frozen=True)
class SeenPoints:
    """Where the rays of a camera end; P rays."""

    distance: np.ndarray
    """Distance from the eye [m], infinite for the backdrop, shape [P]."""
    surface: np.ndarray
    """Index of the surface, ``NOTHING`` or ``TABLE``, shape [P]."""
    normal: np.ndarray
    """Unit smooth normals, shape [P, 3] float32."""
    albedo: np.ndarray
    """Linear colors, shape [P, 3] float32."""
    direction: np.ndarray
    """Unit view directions, shape [P, 3] float32."""


class RayTracer:
    """Surfaces in the world, and the light on them."""

    def __init__(self, surfaces: Sequence[SurfaceMesh], look: Look, table_center: np.ndarray | None = None):
        """
        Args:
            surfaces: all that casts shadows.
            look: light, table top and backdrop; its ``light`` must be given.
            table_center: where the endless table top does not fade, (x, y) [m]; None for no table top.
        """
        self._surfaces, self._look, self._center = surfaces, look, table_center
        light = np.asarray(look.light, dtype=float)
        self._light = light / np.linalg.norm(light)
        self._caster = RayCaster((surface.vertices, surface.faces) for surface in surfaces)
        self._specular = np.array([surface.specular for surface in surfaces], np.float32)
        self._shininess = np.array([surface.shininess for surface in surfaces], np.float32)

    def see(self, rays: PixelRays, *, shaded: bool = True) -> SeenPoints:
        """What is at the pixels' centers, row by row.

        Args:
            shaded: False leaves normals and colors of surfaces zero.
        """
        directions = rays.directions(_image_points(np.arange(rays.height * rays.width), rays.width))
        return self._meet(rays.eye, directions.astype(np.float32), shaded)

    def picture(
        self, rays: PixelRays, points: SeenPoints, *, shadows: bool = True, antialias: int = 2
    ) -> np.ndarray:
        """Linear light of the pixels, shape [H, W, 3] float32.

        Args:
            points: what ``see`` found for the same rays.
            shadows: whether surfaces shade one another.
            antialias: n for n x n rays through the pixels on edges; 1 for none.
        """
        shape = (rays.height, rays.width)
        if shadows:
            shadow, openness = self._received_light(points, rays)
        else:
            shadow = openness = np.ones(len(points.surface), np.float32)
        picture = self._shade(points, shadow, openness, rays)
        if antialias > 1:
            edge = _edges(points, shape)
            inner = (np.arange(antialias) + 0.5) / antialias - 0.5
            steps = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
            fine = rays.directions((_image_points(edge, rays.width)[:, None] + steps).reshape(-1, 2))
            around = self._meet(rays.eye, fine.astype(np.float32), True)
            nearest = _nearest_alike(around, points, np.repeat(edge, len(steps)), shape)
            light = self._shade(around, shadow[nearest], openness[nearest], rays)
            picture[edge] = light.reshape(len(edge), len(steps), 3).mean(1)
        return picture.reshape(*shape, 3)

    def _meet(self, eye: np.ndarray, directions: np.ndarray, shaded: bool) -> SeenPoints:
        hits = self._caster.cast(eye, directions)
        distance, seen = hits.distance, hits.mesh
        normal, albedo = np.zeros_like(directions), np.zeros_like(directions)
        if shaded:
            for i, surface in enumerate(self._surfaces):
                rows = np.flatnonzero(seen == i)
                if len(rows):
                    triangle, barycentric = hits.triangle[rows], hits.barycentric[rows]
                    normal[rows] = surface.normals(triangle, barycentric)
                    albedo[rows] = surface.albedo(triangle, barycentric)
            normal /= np.maximum(np.sqrt(dot(normal, normal)), 1e-9)[:, None]
            normal = np.where(dot(normal, directions)[:, None] > 0, -normal, normal)
        if self._center is not None and eye[2] > 0:
            down = np.minimum(directions[:, 2].astype(float), -1e-9)
            table = np.where(directions[:, 2] < -1e-6, -eye[2] / down, np.inf)
            nearer = (table <= distance + _TIE) & np.isfinite(table)
            distance, seen = np.where(nearer, table, distance), np.where(nearer, TABLE, seen)
            normal[nearer] = (0.0, 0.0, 1.0)
        return SeenPoints(distance, seen, normal, albedo, directions)

    def _received_light(self, points: SeenPoints, rays: PixelRays) -> tuple[np.ndarray, np.ndarray]:
        """How much of the key light and of the surroundings reaches each pixel, shape [H * W] each."""
        look, shape = self._look, (rays.height, rays.width)
        receives = (points.surface >= 0) | self._table_may_be_shaded(points, rays)
        samples = sampled_pixels(*shape) & receives
        shadow = np.ones(len(receives), np.float32)
        openness = shadow.copy()
        lit_rows = np.flatnonzero(samples & (points.normal @ self._light > 0))
        across = axes_along(self._light[None])[0, :, :2]
        lights = self._light + look.light_spread * disc_sample(_image_points(lit_rows, shape[1])) @ across.T
        lights /= np.sqrt(dot(lights, lights))[:, None]
        free = self._free_distance(points, rays.eye, lit_rows, lights, SHADOW_REACH)
        shadow[samples] = 0.0
        shadow[lit_rows] = free >= 0.999 * SHADOW_REACH
        rows = np.flatnonzero(samples)
        around = axes_along(points.normal[rows].astype(float))
        # Samples about +z, turned into each point's frame [P, 3, 3], whose third column is the normal.
        lights = np.einsum("pij,pj->pi", around, hemisphere_sample(_image_points(rows, shape[1])))
        free = self._free_distance(points, rays.eye, rows, lights, look.occlusion_radius)
        openness[rows] = DARKEST + (1 - DARKEST) * free / look.occlusion_radius
        values = [shadow.reshape(shape), openness.reshape(shape)]
        planes = (a.reshape(shape) for a in (receives, samples, points.surface, points.distance))
        shadow, openness = average_over_neighbors(values, *planes)
        return shadow.ravel(), openness.ravel()

    def _free_distance(
        self, points: SeenPoints, eye: np.ndarray, rows: np.ndarray, directions: np.ndarray, limit: float
    ) -> np.ndarray:
        """How far light rays from some of the points get [m], at most ``limit``, shape [R]."""
        origins = eye + points.distance[rows, None] * points.direction[rows] + _LIFT * points.normal[rows]
        return self._caster.free_distance(origins, directions, limit)

    def _table_may_be_shaded(self, points: SeenPoints, rays: PixelRays) -> np.ndarray:
        """Which points lie on the table in a rectangle outside which nothing can shade it, shape [P] bool."""
        table = points.surface == TABLE
        if not table.any() or not self._surfaces:
            return np.zeros_like(table)
        ends = [end(s.vertices, axis=0) for s in self._surfaces for end in (np.min, np.max)]
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        # Straight below, and along the light: the farthest shadow is that of the highest point.
        top, up = max(float(high[2]), 0.0), max(float(self._light[2]), 1e-3)
        shift, blur = -self._light[:2] / up * top, self._look.light_spread * top / up**2
        near = self._look.occlusion_radius
        low, high = low[:2] + np.minimum(shift - blur, -near), high[:2] + np.maximum(shift + blur, near)
        # Averaging over neighbors spreads the shade by a few pixels.
        down = np.maximum(-points.direction[:, 2], 1e-6)
        distance = np.where(table, points.distance, 0.0)
        wide = (_SPREAD / rays.focal * distance / down)[:, None]
        place = rays.eye[:2] + distance[:, None] * points.direction[:, :2]
        return table & np.all((place > low - wide) & (place < high + wide), axis=1)

    def _shade(
        self, points: SeenPoints, shadow: np.ndarray, openness: np.ndarray, rays: PixelRays
    ) -> np.ndarray:
        """Linear light that leaves the points towards the eye, shape [P, 3]."""
        look, light = self._look, self._light.astype(np.float32)
        result = np.zeros(points.normal.shape, np.float32)
        sky = np.flatnonzero(points.surface == NOTHING)
        result[sky] = backdrop(look, points.direction[sky])
        table = np.flatnonzero(points.surface == TABLE)
        if len(table) and self._center is not None:
            direction, distance = points.direction[table], points.distance[table].astype(np.float32)
            place = rays.eye[:2].astype(np.float32) + distance[:, None] * direction[:, :2]
            albedo = table_top(look, place, direction, distance / np.float32(rays.focal))
            color = lit_table(look, albedo, light, shadow[table], openness[table])
            fade = table_fade(look, place, self._center.astype(np.float32))[:, None]
            horizon = linear(np.asarray(look.backdrop_horizon))
            result[table] = horizon + fade * (color - horizon)
        solid = np.flatnonzero(points.surface >= 0)
        surface = points.surface[solid]
        result[solid] = lit(
            look,
            points.albedo[solid],
            points.normal[solid],
            points.direction[solid],
            light,
            shadow[solid],
            openness[solid],
            self._specular[surface],
            self._shininess[surface],
        )
        return soft_clip(result)


def _image_points(pixels: np.ndarray, width: int) -> np.ndarray:
    """(u, v) of pixels numbered row by row, shape [P, 2]."""
    return np.stack([pixels % width, pixels // width], axis=-1)


def _edges(points: SeenPoints, shape: tuple[int, int]) -> np.ndarray:
    """Pixels beside which another surface begins, or a crease or a step of the same one."""
    surface, normal = points.surface.reshape(shape), points.normal.reshape(*shape, 3)
    distance = np.where(points.surface >= 0, points.distance, 0.0).reshape(shape)
    edge = np.zeros(shape, bool)
    for a, b in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        step = np.abs(distance[a] - distance[b]) > 0.03 * np.minimum(distance[a], distance[b])
        crease = (dot(normal[a], normal[b]) < 0.85) & (surface[a] >= 0)
        differs = (surface[a] != surface[b]) | step | crease
        edge[a] |= differs
        edge[b] |= differs
    return np.flatnonzero(edge)


def _nearest_alike(
    around: SeenPoints, points: SeenPoints, pixel: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Index of the neighboring pixel that sees the same surface at the nearest distance, shape [P]."""
    row, column = np.divmod(pixel, shape[1])
    best, gap = pixel.copy(), np.full(len(pixel), np.inf)
    for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
        other = np.clip(row + dy, 0, shape[0] - 1) * shape[1] + np.clip(column + dx, 0, shape[1] - 1)
        same = points.surface[other] == around.surface
        solid = same & (around.surface >= 0)
        apart = np.where(same, 1e-4 * (dx * dx + dy * dy), np.inf)
        apart[solid] += np.abs(points.distance[other[solid]] - around.distance[solid])
        nearer = apart < gap
        best, gap = np.where(nearer, other, best), np.where(nearer, apart, gap)
    return best
