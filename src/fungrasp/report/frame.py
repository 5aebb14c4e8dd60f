"""One frame in the making: which surface each pixel sees, what light reaches it, and its colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.report.camera import Camera
from fungrasp.report.casting import (
    Hits,
    seen_tiles,
    shadowed_tiles,
    spread_tiles,
    tile_centres,
)
from fungrasp.report.shading import (
    Look,
    Materials,
    backdrop,
    linear,
    lit,
    lit_table,
    soft_clip,
    table_fade,
    table_top,
)
from fungrasp.report.surfaces import MeshSurface

NOTHING, TABLE = -1, -2
"""Values of a segmentation where no geom is seen."""

PATTERN = 4
"""Neighbouring pixels, this many in a row and a column, share their samples of the light."""

_OFFSET = 2e-4
_TIE = 1e-4


@dataclass(frozen=True)
class Scene:
    """What all frames of a film have in common."""

    model: mujoco.MjModel
    look: Look
    materials: Materials
    meshes: Mapping[int, MeshSurface]
    """Surface of each drawn mesh, by geom id."""
    sun: np.ndarray
    """Unit vector towards the key light, shape [3]."""
    middle: np.ndarray
    """Middle of the scene, (x, y) [m]."""
    ground: bool
    shadows: bool


@dataclass(frozen=True)
class Points:
    """Surface points that rays have met; P points."""

    distance: np.ndarray
    """From the camera [m], infinite for the sky, shape [P]."""
    geom: np.ndarray
    """Geom id, ``NOTHING`` or ``TABLE``, shape [P]."""
    normal: np.ndarray
    """Flat unit normals, shape [P, 3]."""
    direction: np.ndarray
    """Unit view directions, shape [P, 3]."""


class Frame:
    """Buffers of one frame, filled step by step by ``fungrasp.report.render``."""

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        colours: np.ndarray,
        centres: np.ndarray,
        rotations: np.ndarray,
        radii: np.ndarray,
    ):
        """
        Args:
            colours: linear, shape [ngeom, 3].
            centres: of the geoms [m], shape [ngeom, 3].
            rotations: world from geom, shape [ngeom, 3, 3].
            radii: of their bounding spheres [m], shape [ngeom].
        """
        self.scene, self.camera, self.colours = scene, camera, colours
        self.centres, self.rotations, self.radii = centres, rotations, radii
        self.eye = np.asarray(camera.position, dtype=float)
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        self.pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        self.direction = camera.directions(self.pixels.astype(np.float32))

    def first_rays(self) -> np.ndarray:
        """Directions of the rays worth casting, shape [R, 3]."""
        tiles = seen_tiles(self.camera, self.centres, self.radii)
        self._cast = np.flatnonzero(spread_tiles(tiles, self.camera))
        return self.camera.directions(self.pixels[self._cast].astype(float))

    def see(self, hits: Hits) -> None:
        """Take in what the first rays met, and the table."""
        count = len(self.pixels)
        distance = np.full(count, np.inf)
        geom = np.full(count, NOTHING, np.int32)
        normal = np.zeros((count, 3), np.float32)
        distance[self._cast], geom[self._cast], normal[self._cast] = hits.distance, hits.geom, hits.normal
        self.points = self._with_table(distance, geom, normal, self.direction)

    def light_rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Rays that tell what light arrives: origins [m] and unit directions, shape [R, 3] each."""
        points, scene = self.points, self.scene
        lit_tiles = spread_tiles(self._table_tiles(), self.camera).ravel()
        solid = points.geom >= 0
        chosen = solid | ((points.geom == TABLE) & lit_tiles)
        towards = points.normal @ scene.sun.astype(np.float32)
        self._shaded = np.flatnonzero(chosen & (towards > 0))
        self._occluded = np.flatnonzero(chosen)
        tangent = float(np.tan(np.radians(scene.look.light_radius)))
        lights = scene.sun + tangent * _disc() @ _frames(scene.sun[None])[0, :, :2].T
        lights /= np.linalg.norm(lights, axis=-1, keepdims=True)
        cell = self.pixels % PATTERN @ [1, PATTERN]
        around = _frames(points.normal[self._occluded].astype(float))
        local = _hemisphere()[_AROUND[cell[self._occluded]]]
        directions = [lights[_TOWARDS[cell[self._shaded]]], np.einsum("pij,pj->pi", around, local)]
        origins = [self._position(i) + _OFFSET * points.normal[i] for i in (self._shaded, self._occluded)]
        return np.concatenate(origins), np.concatenate(directions)

    def receive(self, hits: Hits | None) -> None:
        """Take in what the light rays met; None for a scene without shadows."""
        count = len(self.pixels)
        self.shadow = np.ones(count, np.float32)
        self.openness = np.ones(count, np.float32)
        if hits is None:
            return
        split = len(self._shaded)
        self.shadow[self._shaded] = np.isinf(hits.distance[:split])
        reach = self.scene.look.occlusion_radius
        near = np.clip(1.0 - hits.distance[split:] / reach, 0.0, 1.0)
        self.openness[self._occluded] = 1.0 - 0.9 * near
        mask = np.zeros(count, bool)
        mask[self._occluded] = True
        self.shadow, self.openness = self._smooth([self.shadow, self.openness], mask)

    def edge_rays(self, samples: int) -> np.ndarray:
        """Directions of ``samples`` x ``samples`` rays through each pixel on an edge, shape [R, 3]."""
        shape = (self.camera.height, self.camera.width)
        geom = self.points.geom.reshape(shape)
        normal = self.points.normal.reshape(*shape, 3)
        distance = np.where(np.isinf(self.points.distance), 0, self.points.distance).reshape(shape)
        edge = np.zeros(shape, bool)
        for axis in (0, 1):
            a, b = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
            both = (geom[a] >= 0) & (geom[b] >= 0)
            step = np.abs(distance[a] - distance[b]) > 0.01 * np.minimum(distance[a], distance[b])
            bend = np.sum(normal[a] * normal[b], -1) < 0.9
            differs = (geom[a] != geom[b]) | (both & (step | bend))
            edge[a] |= differs
            edge[b] |= differs
        self._edge = np.flatnonzero(edge)
        inner = (np.arange(samples) + 0.5) / samples - 0.5
        u, v = np.meshgrid(inner, inner)
        self._inner = np.stack([u, v], -1).reshape(-1, 2)
        sub = self.pixels[self._edge][:, None] + self._inner
        return self.camera.directions(sub.reshape(-1, 2))

    def colour(self, edge: Hits | None) -> np.ndarray:
        """The finished picture; ``edge``: what the edge rays met, or None. Returns linear light, shape [H, W, 3]."""
        picture = soft_clip(self._shade(self.points, self.shadow, self.openness))
        if edge is not None and len(self._edge):
            direction = self.camera.directions(
                (self.pixels[self._edge][:, None] + self._inner).reshape(-1, 2)
            )
            points = self._with_table(
                edge.distance, edge.geom, edge.normal.astype(np.float32), direction.astype(np.float32)
            )
            pixel = np.repeat(self._edge, len(self._inner))
            shadow, openness = self._borrow(points, pixel)
            sub = soft_clip(self._shade(points, shadow, openness))
            picture[self._edge] = sub.reshape(len(self._edge), len(self._inner), 3).mean(1)
        return picture.reshape(self.camera.height, self.camera.width, 3)

    def _with_table(
        self, distance: np.ndarray, geom: np.ndarray, normal: np.ndarray, direction: np.ndarray
    ) -> Points:
        if self.scene.ground and self.eye[2] > 0:
            down = direction[:, 2].astype(float)
            table = np.where(down < -1e-6, -self.eye[2] / np.minimum(down, -1e-6), np.inf)
            seen = (table <= distance + _TIE) & np.isfinite(table)
            distance = np.where(seen, table, distance)
            geom = np.where(seen, TABLE, geom)
            normal = np.where(seen[:, None], np.array([0, 0, 1], np.float32), normal)
        return Points(distance, geom, normal, direction)

    def _position(self, index: np.ndarray) -> np.ndarray:
        return self.eye + self.points.distance[index, None] * self.points.direction[index]

    def _table_tiles(self) -> np.ndarray:
        image = tile_centres(self.camera)
        direction = self.camera.directions(image).reshape(-1, 3)
        if not self.scene.ground or self.eye[2] <= 0:
            return np.zeros(image.shape[:2], bool)
        down = np.minimum(direction[:, 2], -1e-6)
        distance = -self.eye[2] / down
        points = self.eye + distance[:, None] * direction
        widths = 6.0 / self.camera.focal * distance / -down
        spread = float(np.tan(np.radians(self.scene.look.light_radius)))
        finite = np.where(np.isinf(self.radii), 0.0, self.radii)
        sun = shadowed_tiles(points, widths, self.scene.sun, spread, self.centres, finite)
        apart = np.linalg.norm(points[:, None] - self.centres, axis=-1)
        near = np.any(
            (finite > 0) & (apart < finite + self.scene.look.occlusion_radius + widths[:, None]), axis=1
        )
        here = (direction[:, 2] < 0) & (
            np.linalg.norm(points[:, :2] - self.scene.middle, axis=1) < self.scene.look.fade[1]
        )
        return ((sun | near) & here).reshape(image.shape[:2])

    def _smooth(self, values: list[np.ndarray], mask: np.ndarray) -> list[np.ndarray]:
        shape = (self.camera.height, self.camera.width)
        rows, columns = np.flatnonzero(mask.reshape(shape).any(1)), np.flatnonzero(mask.reshape(shape).any(0))
        if not len(rows):
            return values
        low = np.array([rows[0], columns[0]])
        high = np.array([rows[-1], columns[-1]]) + 1
        pad = PATTERN
        box = np.s_[low[0] : high[0], low[1] : high[1]]

        def framed(x: np.ndarray, fill: float) -> np.ndarray:
            return np.pad(x.reshape(shape)[box], pad, constant_values=fill)

        surface = framed(self.points.geom, -9)
        distance = np.where(surface >= 0, framed(self.points.distance, 0), 0).astype(np.float32)
        inner = np.s_[pad:-pad, pad:-pad]
        centre_surface, centre_distance = surface[inner], distance[inner]
        limit = 0.008 * centre_distance + 1e-6
        height, width = centre_surface.shape
        weight = np.zeros(centre_surface.shape, np.float32)
        padded = [framed(v, 0) for v in values]
        sums = [np.zeros_like(weight) for _ in values]
        for dy, ky in _KERNEL:
            for dx, kx in _KERNEL:
                at = np.s_[pad + dy : pad + dy + height, pad + dx : pad + dx + width]
                same = (surface[at] == centre_surface) & (np.abs(distance[at] - centre_distance) <= limit)
                w = same * np.float32(kx * ky)
                weight += w
                for total, value in zip(sums, padded, strict=True):
                    total += w * value[at]
        result = []
        for value, total in zip(values, sums, strict=True):
            whole = value.reshape(shape).copy()
            whole[box] = np.where(mask.reshape(shape)[box], total / weight, whole[box])
            result.append(whole.ravel())
        return result

    def _borrow(self, points: Points, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        width, height = self.camera.width, self.camera.height
        u, v = self.pixels[pixel].T
        shadow, openness = self.shadow[pixel], self.openness[pixel]
        best = np.full(len(pixel), np.inf)
        solid = points.geom >= 0
        for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            other = np.clip(v + dy, 0, height - 1) * width + np.clip(u + dx, 0, width - 1)
            apart = np.where(solid, np.abs(self.points.distance[other] - points.distance), 0.0) + 1e-4 * (
                dx * dx + dy * dy
            )
            better = (self.points.geom[other] == points.geom) & (apart < best)
            shadow = np.where(better, self.shadow[other], shadow)
            openness = np.where(better, self.openness[other], openness)
            best = np.where(better, apart, best)
        return shadow, openness

    def _shade(self, points: Points, shadow: np.ndarray, openness: np.ndarray) -> np.ndarray:
        scene, look = self.scene, self.scene.look
        sun = scene.sun.astype(np.float32)
        result = backdrop(look, points.direction)
        table = np.flatnonzero(points.geom == TABLE)
        if len(table):
            direction = points.direction[table]
            distance = points.distance[table].astype(np.float32)
            ground = self.eye[:2].astype(np.float32) + distance[:, None] * direction[:, :2]
            fade = table_fade(look, ground, scene.middle.astype(np.float32))[:, None]
            footprint = distance / np.float32(self.camera.focal)
            slant = footprint / np.maximum(-direction[:, 2], 1e-4)
            flat = direction[:, :2] / np.sqrt(np.sum(direction[:, :2] ** 2, -1, keepdims=True) + 1e-12)
            widths = np.abs(flat) * slant[:, None] + np.abs(flat[:, ::-1]) * footprint[:, None]
            albedo = table_top(look, ground, widths)
            colour = lit_table(look, albedo, sun, shadow[table], openness[table])
            result[table] = fade * colour + (1 - fade) * result[table]
        solid = np.flatnonzero(points.geom >= 0)
        if len(solid):
            geom = points.geom[solid]
            normal, albedo = self._surface(points, solid)
            result[solid] = lit(
                look,
                albedo,
                normal,
                points.direction[solid],
                sun,
                shadow[solid],
                openness[solid],
                scene.materials.specular[geom],
                scene.materials.shininess[geom],
            )
        return result

    def _surface(self, points: Points, solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        geom = points.geom[solid]
        normal = points.normal[solid]
        albedo = self.colours[geom]
        for g, mesh in self.scene.meshes.items():
            rows = np.flatnonzero(geom == g)
            if not len(rows):
                continue
            rotation, at = self.rotations[g], solid[rows]
            world = self.eye + points.distance[at, None] * points.direction[at]
            local, texture = mesh.lookup(
                (world - self.centres[g]) @ rotation, normal[rows].astype(float) @ rotation
            )
            smooth = (local @ rotation.T).astype(np.float32)
            view = points.direction[at]
            away = np.maximum(np.sum(smooth * view, -1, keepdims=True), 0.0)
            smooth = smooth - away * view
            normal[rows] = smooth / np.sqrt(np.sum(smooth**2, -1, keepdims=True))
            if texture is not None and (image := texture_image(self.scene.model, g)) is not None:
                albedo[rows] *= linear(_sample(image, texture))
        return normal, albedo


def texture_image(model: mujoco.MjModel, geom: int) -> np.ndarray | None:
    """The colour texture of a geom's material, sRGB from 0 to 1, shape [H, W, 3], or None."""
    material = int(model.geom_matid[geom])
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1
    if texture < 0:
        return None
    height, width, channels = (
        int(a[texture]) for a in (model.tex_height, model.tex_width, model.tex_nchannel)
    )
    start = int(model.tex_adr[texture])
    data = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)
    return data[..., [0, 1, 2] if channels >= 3 else [0, 0, 0]].astype(np.float32) / 255


def _sample(image: np.ndarray, texture: np.ndarray) -> np.ndarray:
    height, width = image.shape[:2]
    x = np.clip(np.mod(texture[:, 0], 1.0 + 1e-9) * width - 0.5, 0, width - 1)
    y = np.clip((1.0 - np.mod(texture[:, 1], 1.0 + 1e-9)) * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[:, None].astype(np.float32), (y - y0)[:, None].astype(np.float32)
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    return top * (1 - fy) + (image[y1, x0] * (1 - fx) + image[y1, x1] * fx) * fy


def _frames(axes: np.ndarray) -> np.ndarray:
    z = axes
    sign = np.where(z[:, 2] >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z[:, 2])
    b = z[:, 0] * z[:, 1] * a
    x = np.stack([1 + sign * z[:, 0] ** 2 * a, sign * b, -sign * z[:, 0]], -1)
    y = np.stack([b, sign + z[:, 1] ** 2 * a, -z[:, 1]], -1)
    return np.stack([x, y, z], axis=-1)


def _disc() -> np.ndarray:
    count = PATTERN * PATTERN
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _hemisphere() -> np.ndarray:
    disc = _disc()
    return np.concatenate([disc, np.sqrt(1 - np.sum(disc**2, -1, keepdims=True))], axis=-1)


_TOWARDS = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
_AROUND = np.array([5, 13, 7, 15, 9, 1, 11, 3, 6, 14, 4, 12, 10, 2, 8, 0])
_KERNEL = tuple(zip(range(-3, 4), (1, 2, 3, 4, 3, 2, 1), strict=True))
