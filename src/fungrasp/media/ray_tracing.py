"""Ray tracing of surfaces lit by one lamp and the sky, with anti-aliasing.

Steps of an image: rays through the pixel centers; the table top in closed form; from each hit, a ray to the
lamp for shadows and a ray along the normal for ambient occlusion; shading; more rays through pixels on edges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.ray_casting import RayCaster
from fungrasp.media.surfaces import Color, SurfaceMesh, linear

NOTHING, TABLE = -1, -2
"""Segmentation values of the backdrop and the table."""

SHADOW_REACH = 1.2
"""Maximum distance of surfaces that cast shadows [m]; it excludes the walls of a room."""

SKY_REACH = 0.08
"""Maximum distance of surfaces that occlude the sky [m]."""

DARKEST = 0.35
"""Share of sky light at full occlusion."""

KNEE = 0.65
"""Light above this is compressed, so that bright colors keep their hue."""

TILE = 8
"""Side of the tiles of pixels for which rays are cast or skipped together."""

LIFT = 3e-4
"""Offset of secondary rays from their surface [m]."""

TIE = 1e-4
"""Distance by which a surface must be nearer than the table to be visible [m]."""


@dataclass(frozen=True)
class Look:
    """Light, table top and backdrop."""

    backdrop_top: Color = (0.78, 0.83, 0.88)
    """Color of the backdrop overhead."""
    backdrop_horizon: Color = (0.955, 0.96, 0.965)
    """Color at the horizon, to which the table top fades."""
    table: Color = (0.800, 0.812, 0.824)
    """Color of the light squares."""
    table_dark: Color = (0.752, 0.766, 0.780)
    """Color of the dark squares."""
    square: float = 0.05
    """Side of a square of the table top [m]."""
    fade: tuple[float, float] = (0.45, 1.7)
    """Distances from the first camera's target at which the table top begins to fade and disappears [m]."""
    light: tuple[float, float, float] | None = None
    """Direction toward the lamp, world frame; above and to the left of the first camera if None."""
    key: float = 2.2
    """Strength of the lamp."""
    fill: float = 0.95
    """Strength of the sky light."""

    def __post_init__(self) -> None:
        for name in ("backdrop_top", "backdrop_horizon", "table", "table_dark"):
            color = np.asarray(getattr(self, name), dtype=float)
            if color.shape != (3,) or not ((color >= 0) & (color <= 1)).all():
                raise FungraspError(f"{name} must be 3 numbers from 0 to 1, not {getattr(self, name)!r}")
        if self.light is not None and not (np.shape(self.light) == (3,) and np.linalg.norm(self.light) > 0):
            raise FungraspError(f"light must be a direction of 3 numbers, not {self.light!r}")


@dataclass(frozen=True, eq=False)
class PixelRays:
    """Camera parameters for the ray tracer."""

    width: int
    """Image width [pixels]."""
    height: int
    """Image height [pixels]."""
    eye: np.ndarray
    """Origin of the rays [m], world frame, shape [3]."""
    focal: float
    """Focal length [pixels]."""
    directions: Callable[[np.ndarray], np.ndarray]
    """Function from image points (u, v), shape [..., 2], to unit view directions, world frame, shape
    [..., 3]."""

    @cached_property
    def grid(self) -> np.ndarray:
        """Unit view directions of the pixels in row-major order, world frame, shape [H * W, 3] float32."""
        return self.through(np.arange(self.height * self.width), np.zeros((1, 2)))

    def through(self, pixels: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return unit view directions, world frame, shape [P * K, 3] float32.

        Args:
            pixels: row-major pixel indices, shape [P].
            steps: offsets (u, v) from pixel centers, shape [K, 2].
        """
        centers = np.stack([pixels % self.width, pixels // self.width], axis=-1)
        points = (centers[:, None] + steps).reshape(-1, 2).astype(np.float32)
        return np.ascontiguousarray(self.directions(points), np.float32)


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Hits of P camera rays."""

    distance: np.ndarray
    """Distance from the eye [m], infinite for the backdrop, shape [P]."""
    surface: np.ndarray
    """Index of the surface, ``NOTHING`` or ``TABLE``, shape [P]."""
    normal: np.ndarray
    """Unit shading normals, shape [P, 3] float32."""
    albedo: np.ndarray
    """Linear colors, shape [P, 3] float32."""
    direction: np.ndarray
    """Unit view directions, shape [P, 3] float32."""

    def at(self, rows: np.ndarray) -> SeenPoints:
        """Return some of the hits."""
        arrays = (self.distance, self.surface, self.normal, self.albedo, self.direction)
        return SeenPoints(*(array[rows] for array in arrays))


class RayTracer:
    """Ray tracer for surfaces in the world frame."""

    def __init__(self, surfaces: Sequence[SurfaceMesh], look: Look, table_center: np.ndarray | None = None):
        """
        Args:
            look: light, table top and backdrop; its ``light`` must be given.
            table_center: center of the infinite table top, around which it does not fade, (x, y) [m]; no
                table top if None.
        """
        self._surfaces, self._look = surfaces, look
        self._center = None if table_center is None else (float(table_center[0]), float(table_center[1]))
        light = np.asarray(look.light, np.float32)
        self._light = light / np.linalg.norm(light)
        self._caster = RayCaster((surface.vertices, surface.faces) for surface in surfaces)
        ends = [(s.vertices.min(axis=0), s.vertices.max(axis=0)) for s in surfaces]
        self._low, self._high = np.array(ends).reshape(-1, 2, 3).transpose(1, 0, 2)
        normals = [s.corner_normals for s in surfaces] or [np.zeros((0, 3, 3))]
        self._normals = np.concatenate(normals).astype(np.float32)
        self._first = np.cumsum([0, *(len(s.faces) for s in surfaces)])[:-1]
        colors = [s.color if s.color.ndim == 1 else s.color[0] for s in surfaces]
        self._colors = np.array(colors, np.float32).reshape(-1, 3)
        self._gloss = np.array([(s.specular, s.shininess) for s in surfaces], np.float32).reshape(-1, 2)

    def see(self, rays: PixelRays, *, shaded: bool = True) -> SeenPoints:
        """Return the hits at the pixel centers, in row-major order.

        Args:
            shaded: whether to compute normals and colors of surfaces; otherwise they are zero.
        """
        return self._meet(_empty(rays, self._center), rays.eye, self._aimed(rays), shaded)

    def picture(
        self, rays: PixelRays, points: SeenPoints, *, shadows: bool = True, antialias: int = 2
    ) -> np.ndarray:
        """Return the linear light of the pixels, shape [H, W, 3] float32.

        Args:
            points: result of ``see`` for the same rays.
            shadows: whether to cast shadows.
            antialias: n for n x n rays through the pixels on edges; 1 for none.
        """
        shape = (rays.height, rays.width)
        received = self._received(points, rays, shadows)
        picture = _lit_table(rays, self._center, self._look).copy()
        rows = np.flatnonzero((points.surface >= 0) | (received[:, 0] < 1) | (received[:, 1] < 1))
        picture[rows] = self._shade(points.at(rows), received[rows], rays)
        if antialias > 1:
            edge = np.flatnonzero(_edges(points, received[:, 0], shape))
            inner = (np.arange(antialias) + 0.5) / antialias - 0.5
            steps = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
            fine = _without_surfaces(rays.through(edge, steps), rays.eye, self._center)
            around = self._meet(fine, rays.eye, np.arange(len(fine.surface)), True)
            light = self._shade(around, self._received(around, rays, shadows), rays)
            picture[edge] = light.reshape(len(edge), len(steps), 3).mean(axis=1)
        return picture.reshape(*shape, 3)

    def _aimed(self, rays: PixelRays) -> np.ndarray:
        """Return pixels whose rays may hit a surface: those of tiles that see the bounding sphere of one."""
        shape = (rays.height, rays.width)
        rows, columns = (np.minimum(np.arange(0, n, TILE) + TILE // 2, n - 1) for n in shape)
        middles = rays.grid.reshape(*shape, 3)[np.ix_(rows, columns)]
        away = 0.5 * (self._low + self._high) - rays.eye
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        radius = 0.5 * np.linalg.norm(self._high - self._low, axis=1) + TIE
        angle = np.where(radius < distance, np.arcsin(np.minimum(radius / distance, 1.0)), np.pi)
        between = np.arccos(np.clip(middles @ (away / distance[:, None]).T, -1.0, 1.0))
        tiles = (between < angle + 1.5 * TILE / rays.focal + 1e-3).any(axis=-1)
        aimed = tiles.repeat(TILE, axis=0).repeat(TILE, axis=1)[: shape[0], : shape[1]]
        return np.flatnonzero(aimed)

    def _meet(self, empty: SeenPoints, eye: np.ndarray, rays: np.ndarray, shaded: bool) -> SeenPoints:
        """Return hits. empty: hits without surfaces; rays: rays that may hit a surface."""
        points = SeenPoints(
            empty.distance.copy(),
            empty.surface.copy(),
            empty.normal.copy(),
            empty.albedo.copy(),
            empty.direction,
        )
        if not len(rays) or not self._surfaces:
            return points
        hits = self._caster.cast(eye, points.direction[rays])
        met = np.flatnonzero((hits.mesh >= 0) & (hits.distance < points.distance[rays] - TIE))
        rays, mesh, triangle = rays[met], hits.mesh[met], hits.triangle[met]
        weights = hits.barycentric[met].astype(np.float32)
        points.surface[rays], points.distance[rays] = mesh, hits.distance[met]
        if shaded:
            normal = np.einsum("pc,pci->pi", weights, self._normals[self._first[mesh] + triangle])
            # Normalize and orient toward the eye.
            size = np.maximum(np.sqrt(_dot(normal, normal)), 1e-9)
            normal *= (np.where(_dot(normal, points.direction[rays]) > 0, -1, 1) / size)[:, None]
            points.normal[rays] = normal
            points.albedo[rays] = self._colors[mesh]
            for i, surface in enumerate(self._surfaces):
                if surface.texture is not None or surface.color.ndim == 2:
                    own = np.flatnonzero(mesh == i)
                    points.albedo[rays[own]] = surface.albedo(triangle[own], weights[own])
        return points

    def _received(self, points: SeenPoints, rays: PixelRays, shadows: bool) -> np.ndarray:
        """Return the shares of lamp and sky light that reach the points, shape [P, 2] float32."""
        received = np.ones((len(points.surface), 2), np.float32)
        if not shadows or not self._surfaces:
            return received
        rows = np.flatnonzero((points.surface >= 0) | self._table_may_be_shaded(points, rays.eye))
        normal = points.normal[rows]
        begin = rays.eye + points.distance[rows, None] * points.direction[rows] + LIFT * normal
        free = self._caster.free_distance(begin, normal, SKY_REACH)
        received[rows, 1] = DARKEST + (1 - DARKEST) * free / SKY_REACH
        facing = normal @ self._light > 0
        towards = np.broadcast_to(self._light, (int(facing.sum()), 3))
        free = self._caster.free_distance(begin[facing], towards, SHADOW_REACH)
        received[rows, 0] = 0.0
        received[rows[facing], 0] = free >= 0.999 * SHADOW_REACH
        return received

    def _table_may_be_shaded(self, points: SeenPoints, eye: np.ndarray) -> np.ndarray:
        """Return which points are on the table within the rectangle of possible shadows, shape [P] bool."""
        low, high = self._low.min(axis=0), self._high.max(axis=0)
        # Surfaces shade the table below them and along the light, the farther the higher they are.
        shift = -self._light[:2] / max(float(self._light[2]), 1e-3) * max(float(high[2]), 0.0)
        low, high = low[:2] + np.minimum(shift, 0.0) - TIE, high[:2] + np.maximum(shift, 0.0) + TIE
        shaded = points.surface == TABLE
        for axis in range(2):
            place = np.where(shaded, points.distance, 0.0) * points.direction[:, axis] + eye[axis]
            shaded &= (place > low[axis]) & (place < high[axis])
        return shaded

    def _shade(self, points: SeenPoints, received: np.ndarray, rays: PixelRays) -> np.ndarray:
        """Return the linear light from the points to the eye, shape [P, 3] float32."""
        light = _background(points, received, rays, self._center, self._look)
        rows = np.flatnonzero(points.surface >= 0)
        points, received = points.at(rows), received[rows]
        key, sky, bounce = _lights(self._look)
        lamp = received[:, :1] * np.maximum(points.normal @ self._light, 0.0)[:, None]
        up = 0.5 + 0.5 * points.normal[:, 2:]
        around = received[:, 1:] * (up * sky + (1 - up) * bounce)
        half = self._light - points.direction
        strength, exponent = self._gloss[points.surface].T
        along = _dot(points.normal, half) / np.maximum(np.sqrt(_dot(half, half)), 1e-9)
        shine = np.maximum(along, 0.0) ** exponent
        shine *= strength * (exponent + 8) / 120.0
        light[rows] = _soft(points.albedo * (lamp * key + around) + shine[:, None] * lamp)
        return light


def _without_surfaces(
    directions: np.ndarray, eye: np.ndarray, center: tuple[float, float] | None
) -> SeenPoints:
    """Return hits with the table top alone, the plane z = 0, or with nothing if ``center`` is None."""
    count = len(directions)
    distance, surface = np.full(count, np.inf), np.full(count, NOTHING)
    normal, albedo = np.zeros((2, count, 3), np.float32)
    if center is not None and eye[2] > 0:
        down = np.flatnonzero(directions[:, 2] < -1e-6)
        distance[down] = -eye[2] / directions[down, 2].astype(float)
        surface[down], normal[down, 2] = TABLE, 1.0
    return SeenPoints(distance, surface, normal, albedo, directions)


@lru_cache(maxsize=4)
def _empty(rays: PixelRays, center: tuple[float, float] | None) -> SeenPoints:
    """Cache hits without surfaces, because videos have few cameras."""
    return _without_surfaces(rays.grid, np.asarray(rays.eye, dtype=float), center)


@lru_cache(maxsize=4)
def _lit_table(rays: PixelRays, center: tuple[float, float] | None, look: Look) -> np.ndarray:
    """Return the linear light of pixels without surfaces, shape [P, 3] float32. Do not change it."""
    points = _empty(rays, center)
    return _background(points, np.ones((len(points.surface), 2), np.float32), rays, center, look)


def _lights(look: Look) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the linear colors of the lamp, the sky and the table's reflection, shape [3] float32 each."""
    key = np.float32(look.key / np.pi) * np.array([1.0, 0.965, 0.91], np.float32)
    sky = np.float32(0.62 * look.fill) * np.array([0.93, 0.97, 1.03], np.float32)
    return key, sky, np.float32(0.42 * look.fill) * linear(np.array(look.table))


def _background(
    points: SeenPoints, received: np.ndarray, rays: PixelRays, center: tuple[float, float] | None, look: Look
) -> np.ndarray:
    """Return the linear light of table and backdrop, shape [P, 3] float32, with the table's squares filtered
    over the width of a pixel. received: shares of lamp and sky light, shape [P, 2]."""
    light = np.empty(points.normal.shape, np.float32)
    horizon, top, plain, dark = linear(
        np.array([look.backdrop_horizon, look.backdrop_top, look.table, look.table_dark])
    )
    rows = np.flatnonzero(points.surface == NOTHING)
    height = np.clip(1.6 * points.direction[rows, 2:], 0.0, 1.0)
    light[rows] = _soft(horizon + height * (top - horizon))
    rows = np.flatnonzero(points.surface == TABLE)
    if not len(rows) or center is None:
        return light
    view, distance = points.direction[rows], points.distance[rows, None].astype(np.float32)
    place = np.asarray(rays.eye[:2], np.float32) + distance * view[:, :2]
    # A pixel's footprint: longer along the view.
    width = distance / np.float32(rays.focal)
    along = np.abs(view[:, :2]) / np.sqrt((view[:, :2] ** 2).sum(axis=1, keepdims=True) + 1e-12)
    spread = along * (width / np.maximum(-view[:, 2:], 1e-4)) + along[:, ::-1] * width
    spread = np.maximum(spread / look.square, 1e-4)
    middle = place / look.square
    wave = (_triangle(middle + 0.5 * spread) - _triangle(middle - 0.5 * spread)) / spread
    color = plain + (0.5 - 0.5 * wave[:, :1] * wave[:, 1:]) * (dark - plain)
    begin, end = look.fade
    far = np.linalg.norm(place - np.asarray(center, np.float32), axis=1, keepdims=True)
    share = np.clip((end - far) / (end - begin), 0.0, 1.0)
    share *= share * (3 - 2 * share)
    key, sky, _ = _lights(look)
    up = max(look.light[2] / float(np.linalg.norm(look.light)), 0.0) if look.light else 0.0
    color *= received[rows, :1] * up * key + received[rows, 1:] * sky
    light[rows] = _soft(horizon + share * (color - horizon))
    return light


def _soft(light: np.ndarray) -> np.ndarray:
    """Compress light above ``KNEE``."""
    over = np.maximum(light - KNEE, 0.0)
    return np.minimum(light, KNEE) + (1 - KNEE) * over / (over + (1 - KNEE))


def to_bytes(light: np.ndarray) -> np.ndarray:
    """Convert linear light (1 is white) to 8-bit sRGB, any shape."""
    return _GAMMA[(np.clip(light, 0.0, 1.0) * (len(_GAMMA) - 1) + 0.5).astype(np.uint16)]


def sun_direction(look: Look, rotation: np.ndarray) -> tuple[float, float, float]:
    """Return the direction toward the lamp. rotation: camera axes as columns, shape [3, 3]."""
    right, forward = rotation[:, 0], rotation[:, 2]
    if look.light is not None:
        return look.light
    ahead = np.array([forward[0], forward[1], 0.0])
    size = np.linalg.norm(ahead)
    ahead = ahead / size if size > 1e-6 else np.cross([0.0, 0.0, 1.0], right)
    x, y, z = (-0.60 * right - 0.48 * ahead + np.array([0.0, 0.0, 1.05])).tolist()
    return x, y, z


def _edges(points: SeenPoints, lit: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return pixels at the border of a surface, a crease, a depth step or a shadow, shape [H, W] bool.

    lit: share of lamp light, shape [P].
    """
    surface, distance, lit = (each.reshape(shape) for each in (points.surface, points.distance, lit))
    normal = points.normal.reshape(*shape, 3)
    edge = np.zeros(shape, bool)
    for a, b in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        differs = (surface[a] != surface[b]) | (lit[a] != lit[b])
        same = np.nonzero(~differs & (surface[a] >= 0))
        near, far = distance[a][same], distance[b][same]
        bend = _dot(normal[a][same], normal[b][same])
        differs[same] = (np.abs(near - far) > 0.03 * np.minimum(near, far)) | (bend < 0.6)
        edge[a] |= differs
        edge[b] |= differs
    return edge


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return dot products, shape [P]. a, b: shape [P, 3]."""
    return np.einsum("pi,pi->p", a, b)


def _triangle(x: np.ndarray) -> np.ndarray:
    """Return a triangle wave between 0 and 1 with period 2."""
    phase = np.mod(x, 2.0)
    return np.minimum(phase, 2.0 - phase)


_levels = np.linspace(0.0, 1.0, 4096)
_GAMMA = np.where(_levels <= 0.0031308, 12.92 * _levels, 1.055 * _levels ** (1 / 2.4) - 0.055)
_GAMMA = np.round(255 * _GAMMA).astype(np.uint8)
"""8-bit sRGB of evenly spaced levels of linear light."""
