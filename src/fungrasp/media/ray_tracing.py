"""Ray tracing of surfaces: what a camera sees, softly lit and anti-aliased.

The steps of an image: rays through the pixels' centers; the table top in closed form; a shadow ray and an
occlusion ray from every second pixel, whose results are averaged over its neighbors; shading; more rays
through the pixels on edges, lit as the pixels around them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fungrasp.geometry.ray_casting import RayCaster, RayHits
from fungrasp.media.light_sampling import DISC, PASSES, axes_along, pixel_samples, sampled_pixels
from fungrasp.media.pixel_loops import (
    NOTHING,
    TABLE,
    aimed_pixels,
    average_over_neighbors,
    light_rays,
    mark_edges,
    nearest_alike,
    put_hits,
    put_table,
    shade,
    shaded_table,
)
from fungrasp.media.shading import Look
from fungrasp.media.surfaces import SurfaceMesh

__all__ = ["NOTHING", "TABLE", "PixelRays", "RayTracer", "SeenPoints"]

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

    @cached_property
    def grid(self) -> np.ndarray:
        """Unit view directions of the pixels, row by row, world frame, shape [H * W, 3] float32."""
        points = _image_points(np.arange(self.height * self.width), self.width)
        return np.ascontiguousarray(self.directions(points), np.float32)


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
        self._gloss = np.array([(s.specular, s.shininess) for s in surfaces], float).reshape(-1, 2)
        ends = [(s.vertices.min(axis=0), s.vertices.max(axis=0)) for s in surfaces]
        self._low, self._high = np.array(ends).reshape(-1, 2, 3).transpose(1, 0, 2)
        counts = [len(s.faces) for s in surfaces]
        normals = [s.corner_normals for s in surfaces] or [np.zeros((0, 3, 3))]
        colors = [s.color if s.color.ndim == 1 else s.color[0] for s in surfaces]
        self._paint = (
            np.ascontiguousarray(np.concatenate(normals), np.float32),
            np.cumsum([0, *counts])[:-1],
            np.array(colors, dtype=float).reshape(-1, 3),
        )
        self._radii = 0.5 * np.linalg.norm(self._high - self._low, axis=1) + _TIE

    def see(self, rays: PixelRays, *, shaded: bool = True) -> SeenPoints:
        """What is at the pixels' centers, row by row.

        Args:
            shaded: False leaves normals and colors of surfaces zero.
        """
        shape, aimed = (rays.height, rays.width), np.zeros((rays.height, rays.width), bool)
        eye = np.asarray(rays.eye, dtype=float)
        aimed_pixels(aimed, rays.grid.reshape(*shape, 3), eye, 0.5 * (self._low + self._high), self._radii)
        return self._meet(eye, rays.grid, np.flatnonzero(aimed), shaded)

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
        received = (
            self._received_light(points, rays) if shadows else np.ones((len(points.surface), 2), np.float32)
        )
        picture = self._shade(points, received, rays)
        if antialias > 1:
            edges = np.zeros(shape, bool)
            surface, distance = points.surface.reshape(shape), points.distance.reshape(shape)
            mark_edges(edges, surface, points.normal.reshape(*shape, 3), distance)
            edge = np.flatnonzero(edges)
            inner = (np.arange(antialias) + 0.5) / antialias - 0.5
            steps = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
            fine = rays.directions((_image_points(edge, rays.width)[:, None] + steps).reshape(-1, 2))
            everything = np.arange(len(fine))
            around = self._meet(rays.eye, np.ascontiguousarray(fine, np.float32), everything, True)
            nearest = np.empty(len(fine), np.int64)
            pixels = np.repeat(edge, len(steps))
            nearest_alike(nearest, around.surface, around.distance, surface, distance, pixels)
            light = self._shade(around, received[nearest], rays)
            picture[edge] = light.reshape(len(edge), len(steps), 3).mean(1)
        return picture.reshape(*shape, 3)

    def _meet(self, eye: np.ndarray, directions: np.ndarray, rays: np.ndarray, shaded: bool) -> SeenPoints:
        """Where rays end. rays: indices of those that may meet a surface."""
        eye, count = np.asarray(eye, dtype=float), len(directions)
        distance, seen = np.full(count, np.inf), np.full(count, NOTHING)
        normal, albedo = np.zeros_like(directions), np.zeros_like(directions)
        if len(rays) and self._surfaces:
            hits = self._caster.cast(eye, directions[rays])
            met = (hits.mesh, hits.distance, hits.triangle.astype(np.int64), hits.barycentric)
            if shaded:
                put_hits(seen, distance, normal, albedo, rays, directions, *met, *self._paint)
                self._paint_varied(albedo, rays, hits)
            else:
                seen[rays], distance[rays] = hits.mesh, hits.distance
        if self._center is not None and eye[2] > 0:
            put_table(distance, seen, normal, directions, eye, _TIE)
        return SeenPoints(distance, seen, normal, albedo, directions)

    def _paint_varied(self, albedo: np.ndarray, rays: np.ndarray, hits: RayHits) -> None:
        """Colors of the surfaces that have several."""
        for i, surface in enumerate(self._surfaces):
            if surface.texture is not None or surface.color.ndim == 2:
                which = np.flatnonzero(hits.mesh == i)
                if len(which):
                    albedo[rays[which]] = surface.albedo(hits.triangle[which], hits.barycentric[which])

    def _received_light(self, points: SeenPoints, rays: PixelRays) -> np.ndarray:
        """How much of the key light and of the surroundings reaches each pixel, shape [H * W, 2]."""
        look, shape = self._look, (rays.height, rays.width)
        receives = (points.surface >= 0) | self._table_may_be_shaded(points, rays)
        samples = sampled_pixels(*shape) & receives
        received = np.ones((len(receives), 2), np.float32)
        if not samples.any():
            return received
        rows = np.flatnonzero(samples)
        begin, towards, around = np.empty((3, len(rows), 3), np.float32)
        across = look.light_spread * axes_along(self._light[None])[0, :, :2].T
        light_rays(
            begin,
            towards,
            around,
            rows,
            pixel_samples(rows, shape[1]),
            DISC,
            np.asarray(rays.eye, dtype=float),
            points.normal,
            points.direction,
            points.distance,
            np.concatenate([self._light[None], across]),
            _LIFT,
        )
        facing = points.normal[rows] @ self._light > 0
        free = self._caster.free_distance(begin[facing], towards[facing], SHADOW_REACH)
        received[rows, 0] = 0.0
        received[rows[facing], 0] = free >= 0.999 * SHADOW_REACH
        free = self._caster.free_distance(begin, around, look.occlusion_radius)
        received[rows, 1] = DARKEST + (1 - DARKEST) * free / look.occlusion_radius
        return self._averaged(received, receives.reshape(shape), samples.reshape(shape), points)

    def _averaged(
        self, received: np.ndarray, mask: np.ndarray, samples: np.ndarray, points: SeenPoints
    ) -> np.ndarray:
        """Average over neighbors. mask: where light arrives, samples: where it was sampled, [H, W] bool."""
        shape = mask.shape
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        surface, distance = (
            np.ascontiguousarray(a.reshape(shape)[box]) for a in (points.surface, points.distance)
        )
        values, known = received.reshape(*shape, 2)[box].copy(), samples[box].copy()
        for offsets, weights in PASSES:
            result = np.empty_like(values)
            average_over_neighbors(
                result, values, known, surface, distance, np.array(offsets), np.array(weights)
            )
            values, known = result, np.ones_like(known)
        whole = received.reshape(*shape, 2)
        whole[box] = np.where(mask[box][..., None], values, whole[box])
        return whole.reshape(-1, 2)

    def _table_may_be_shaded(self, points: SeenPoints, rays: PixelRays) -> np.ndarray:
        """Which points lie on the table in a rectangle outside which nothing can shade it, shape [P] bool."""
        shaded = np.zeros(len(points.surface), bool)
        if not self._surfaces:
            return shaded
        low, high = self._low.min(axis=0), self._high.max(axis=0)
        # Straight below, and along the light: the farthest shadow is that of the highest point.
        top, up = max(float(high[2]), 0.0), max(float(self._light[2]), 1e-3)
        shift, blur = -self._light[:2] / up * top, self._look.light_spread * top / up**2
        near = self._look.occlusion_radius
        low, high = low[:2] + np.minimum(shift - blur, -near), high[:2] + np.maximum(shift + blur, near)
        # Averaging over neighbors spreads the shade by a few pixels.
        spread = _SPREAD / rays.focal
        eye = np.asarray(rays.eye, dtype=float)
        shaded_table(shaded, points.surface, points.distance, points.direction, eye, low, high, spread)
        return shaded

    def _shade(self, points: SeenPoints, received: np.ndarray, rays: PixelRays) -> np.ndarray:
        """Linear light that leaves the points towards the eye, shape [P, 3]."""
        result = np.empty(points.normal.shape, np.float32)
        center = np.zeros(2) if self._center is None else np.asarray(self._center, dtype=float)
        places = np.array([self._light, rays.eye, (*center, 0.0)], dtype=float)
        shade(
            result,
            points.surface,
            points.distance,
            points.normal,
            points.albedo,
            points.direction,
            received,
            self._gloss,
            self._look.numbers,
            places,
            float(rays.focal),
        )
        return result


def _image_points(pixels: np.ndarray, width: int) -> np.ndarray:
    """(u, v) of pixels numbered row by row, shape [P, 2]."""
    return np.stack([pixels % width, pixels // width], axis=-1).astype(np.float32)
