"""One frame in the making: which surface each pixel sees, what light reaches it, and its colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.rendering.camera import Camera
from fungrasp.rendering.light_sampling import asking, axes_along, disc, hemisphere, share
from fungrasp.rendering.model_rays import Hits
from fungrasp.rendering.shading import (
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
from fungrasp.rendering.surfaces import MeshSurface, dot, sample_image, texture_image
from fungrasp.rendering.tile_culling import Boxes, blocked, near, seen_tiles, spread_tiles, tile_centres

NOTHING, TABLE = -1, -2
"""Values of a segmentation where no geom is seen."""

_LIFT = 2e-4
_TIE = 1e-4
_DARKEST = 0.12


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
    """Where the table does not fade, (x, y) [m]."""
    ground: bool


@dataclass(frozen=True)
class Points:
    """What rays from the camera met; P rays."""

    distance: np.ndarray
    """From the camera [m], infinite for the sky, shape [P]."""
    geom: np.ndarray
    """Geom id, ``NOTHING`` or ``TABLE``, shape [P]."""
    normal: np.ndarray
    """Flat unit normals, shape [P, 3] float32."""
    direction: np.ndarray
    """Unit view directions, shape [P, 3] float32."""


class Frame:
    """Buffers of one frame. The steps are called in the order in which they are written here."""

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        directions: np.ndarray,
        colours: np.ndarray,
        centres: np.ndarray,
        rotations: np.ndarray,
        boxes: Boxes,
    ):
        """
        Args:
            directions: of the rays through all pixels, shape [H * W, 3] float32.
            colours: linear, shape [ngeom, 3].
            centres: of the geoms [m], shape [ngeom, 3].
            rotations: world from geom, shape [ngeom, 3, 3].
            boxes: round what is visible.
        """
        self.scene, self.camera, self.colours = scene, camera, colours
        self.centres, self.rotations, self.boxes = centres, rotations, boxes
        self.eye = np.asarray(camera.position, dtype=float)
        self.shape = (camera.height, camera.width)
        self._directions = directions

    def first_rays(self) -> np.ndarray:
        """Directions of the rays worth casting from the camera, shape [R, 3]."""
        tiles = seen_tiles(self.camera, self.boxes)
        self._cast = np.flatnonzero(spread_tiles(tiles, self.camera))
        return self.camera.directions(self._image(self._cast).astype(float))

    def see(self, hits: Hits) -> None:
        """Take in what the first rays met, and the table."""
        count = len(self._directions)
        distance = np.full(count, np.inf)
        geom = np.full(count, NOTHING, np.int32)
        normal = np.zeros((count, 3), np.float32)
        distance[self._cast], geom[self._cast] = hits.distance, hits.geom
        normal[self._cast] = _towards_eye(hits.normal, self._directions[self._cast])
        self.points = self._with_table(distance, geom, normal, self._directions)

    def depth(self) -> np.ndarray:
        """Along the camera's z [m], 0 where nothing is seen, shape [H, W] float32."""
        forward = self.camera.rotation[:, 2]
        distance = np.where(np.isinf(self.points.distance), 0.0, self.points.distance)
        return (distance * (self._directions @ forward)).astype(np.float32).reshape(self.shape)

    def light_rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Rays that tell what light arrives: origins [m] and unit directions, shape [R, 3] each."""
        points, scene = self.points, self.scene
        solid, table = points.geom >= 0, points.geom == TABLE
        sun, close = (spread_tiles(tiles, self.camera).ravel() for tiles in self._table_tiles())
        towards = points.normal @ scene.sun.astype(np.float32) > 0
        self._asks = asks = asking(self.camera.width, self.camera.height)
        self._receives = solid | (table & (sun | close))
        self._shaded = np.flatnonzero(asks & towards & (solid | (table & sun)))
        self._occluded = np.flatnonzero(asks & (solid | (table & close)))
        across = axes_along(scene.sun[None])[0, :, :2]
        lights = scene.sun + scene.look.light_spread * disc(self._image(self._shaded)) @ across.T
        lights /= np.sqrt(dot(lights, lights))[:, None]
        around = axes_along(points.normal[self._occluded].astype(float))
        directions = [lights, np.einsum("pij,pj->pi", around, hemisphere(self._image(self._occluded)))]
        origins = [self._position(i) + _LIFT * points.normal[i] for i in (self._shaded, self._occluded)]
        return np.concatenate(origins), np.concatenate(directions)

    def receive(self, hits: Hits | None) -> None:
        """Take in what the light rays met; None if nothing shades anything."""
        count = len(self._directions)
        self.shadow, self.openness = np.ones(count, np.float32), np.ones(count, np.float32)
        if hits is None:
            return
        split = len(self._shaded)
        self.shadow[self._shaded] = np.isinf(hits.distance[:split])
        occluded = np.clip(1.0 - hits.distance[split:] / self.scene.look.occlusion_radius, 0.0, 1.0)
        self.openness[self._occluded] = 1.0 - (1.0 - _DARKEST) * occluded
        values = [self.shadow.reshape(self.shape), self.openness.reshape(self.shape)]
        surface, distance = self.points.geom.reshape(self.shape), self.points.distance.reshape(self.shape)
        shared = share(
            values, self._receives.reshape(self.shape), self._asks.reshape(self.shape), surface, distance
        )
        self.shadow, self.openness = (v.ravel() for v in shared)

    def edge_rays(self, samples: int) -> np.ndarray:
        """Directions of ``samples`` x ``samples`` rays through each pixel on an edge, shape [R, 3]."""
        geom = self.points.geom.reshape(self.shape)
        normal = self.points.normal.reshape(*self.shape, 3)
        distance = np.where(geom >= 0, self.points.distance.reshape(self.shape), 0.0)
        edge = np.zeros(self.shape, bool)
        for a, b in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
            differs = geom[a] != geom[b]
            same = np.flatnonzero((geom[a] == geom[b]) & (geom[a] >= 0))
            da, db = distance[a].ravel()[same], distance[b].ravel()[same]
            na, nb = normal[a].reshape(-1, 3)[same], normal[b].reshape(-1, 3)[same]
            differs.reshape(-1)[same] = (np.abs(da - db) > 0.01 * np.minimum(da, db)) | (dot(na, nb) < 0.9)
            edge[a] |= differs
            edge[b] |= differs
        self._edge = np.flatnonzero(edge)
        inner = (np.arange(samples) + 0.5) / samples - 0.5
        self._inner = np.stack(np.meshgrid(inner, inner), -1).reshape(-1, 2)
        self._edge_directions = self.camera.directions(self._image(self._edge)[:, None] + self._inner)
        return self._edge_directions.reshape(-1, 3)

    def colour(self, edge: Hits | None) -> np.ndarray:
        """The picture; ``edge``: what the edge rays met, or None. Returns linear light, shape [H, W, 3]."""
        picture = soft_clip(self._shade(self.points, self.shadow, self.openness))
        if edge is not None and len(self._edge):
            direction = self._edge_directions.reshape(-1, 3).astype(np.float32)
            points = self._with_table(
                edge.distance, edge.geom, _towards_eye(edge.normal, direction), direction
            )
            shadow, openness = self._borrow(points, np.repeat(self._edge, len(self._inner)))
            fine = soft_clip(self._shade(points, shadow, openness))
            picture[self._edge] = fine.reshape(len(self._edge), len(self._inner), 3).mean(1)
        return picture.reshape(*self.shape, 3)

    def _image(self, index: np.ndarray) -> np.ndarray:
        return np.stack([index % self.camera.width, index // self.camera.width], axis=-1)

    def _position(self, index: np.ndarray) -> np.ndarray:
        return self.eye + self.points.distance[index, None] * self.points.direction[index]

    def _with_table(
        self, distance: np.ndarray, geom: np.ndarray, normal: np.ndarray, direction: np.ndarray
    ) -> Points:
        if self.scene.ground and self.eye[2] > 0:
            down = direction[:, 2].astype(float)
            table = np.where(down < -1e-6, -self.eye[2] / np.minimum(down, -1e-6), np.inf)
            seen = (table <= distance + _TIE) & np.isfinite(table)
            distance = np.where(seen, table, distance)
            geom = np.where(seen, TABLE, geom)
            normal[seen] = (0.0, 0.0, 1.0)
        return Points(distance, geom, normal, direction)

    def _table_tiles(self) -> tuple[np.ndarray, np.ndarray]:
        look, image = self.scene.look, tile_centres(self.camera)
        direction = self.camera.directions(image).reshape(-1, 3)
        if not self.scene.ground or self.eye[2] <= 0:
            nowhere = np.zeros(image.shape[:2], bool)
            return nowhere, nowhere
        down = np.minimum(direction[:, 2], -1e-6)
        distance = -self.eye[2] / down
        points = self.eye + distance[:, None] * direction
        widths = 6.0 / self.camera.focal * distance / -down
        here = np.hypot(*(points[:, :2] - self.scene.middle).T) < look.fade[1] + widths
        sun = blocked(points, widths, self.scene.sun, look.light_spread, self.boxes)
        close = near(points, look.occlusion_radius + widths, self.boxes)
        return (sun & here).reshape(image.shape[:2]), (close & here).reshape(image.shape[:2])

    def _borrow(self, points: Points, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Light at edge points: that of the nearest point of the same surface that a neighbouring pixel
        saw.
        """
        height, width = self.shape
        v, u = np.divmod(pixel, width)
        shadow, openness = self.shadow[pixel], self.openness[pixel]
        best = np.full(len(pixel), np.inf)
        solid = points.geom >= 0
        distance = np.where(solid, points.distance, 0.0)
        for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            other = np.clip(v + dy, 0, height - 1) * width + np.clip(u + dx, 0, width - 1)
            apart = np.where(solid, np.abs(self.points.distance[other] - distance), 0.0)
            apart += 1e-4 * (dx * dx + dy * dy)
            better = (self.points.geom[other] == points.geom) & (apart < best)
            shadow = np.where(better, self.shadow[other], shadow)
            openness = np.where(better, self.openness[other], openness)
            best = np.where(better, apart, best)
        return shadow, openness

    def _shade(self, points: Points, shadow: np.ndarray, openness: np.ndarray) -> np.ndarray:
        scene, look = self.scene, self.scene.look
        sun = scene.sun.astype(np.float32)
        result = np.empty((len(points.geom), 3), np.float32)
        sky = np.flatnonzero(points.geom == NOTHING)
        result[sky] = backdrop(look, points.direction[sky])
        table = np.flatnonzero(points.geom == TABLE)
        if len(table):
            direction = points.direction[table]
            distance = points.distance[table].astype(np.float32)
            place = self.eye[:2].astype(np.float32) + distance[:, None] * direction[:, :2]
            albedo = table_top(look, place, direction, distance / np.float32(self.camera.focal))
            colour = lit_table(look, albedo, sun, shadow[table], openness[table])
            fade = table_fade(look, place, scene.middle.astype(np.float32))[:, None]
            horizon = linear(np.asarray(look.backdrop_horizon))
            result[table] = horizon + fade * (colour - horizon)
        solid = np.flatnonzero(points.geom >= 0)
        if len(solid):
            geom = points.geom[solid]
            normal, albedo = self._surface(points, solid)
            specular, shininess = scene.materials.specular[geom], scene.materials.shininess[geom]
            view = points.direction[solid]
            result[solid] = lit(
                look, albedo, normal, view, sun, shadow[solid], openness[solid], specular, shininess
            )
        return result

    def _surface(self, points: Points, solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smooth normals and linear colours of the points with indices ``solid``, shape [S, 3] each."""
        geom = points.geom[solid]
        normal, albedo = points.normal[solid], self.colours[geom]
        for g, mesh in self.scene.meshes.items():
            rows = np.flatnonzero(geom == g)
            if not len(rows):
                continue
            rotation, at = self.rotations[g], solid[rows]
            world = self.eye + points.distance[at, None] * points.direction[at]
            flat = normal[rows].astype(float) @ rotation
            local, texture = mesh.lookup((world - self.centres[g]) @ rotation, flat)
            smooth = (local @ rotation.T).astype(np.float32)
            view = points.direction[at]
            smooth -= np.maximum(dot(smooth, view), 0.0)[:, None] * view
            normal[rows] = smooth / np.sqrt(dot(smooth, smooth))[:, None]
            if texture is not None and (image := texture_image(self.scene.model, g)) is not None:
                albedo[rows] *= linear(sample_image(image, texture))
        return normal, albedo


def _towards_eye(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    normals = normals.astype(np.float32)
    return np.where(dot(normals, directions)[:, None] > 0, -normals, normals)
