"""Ray casting of many states of one model on the CPU threads of ``mujoco.batch``: no display, OpenGL or GPU."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from fungrasp.errors import FungraspError
from fungrasp.report.camera import Camera

TILE = 8
"""Side of the pixel tiles in which rays are skipped together [pixels]."""

VISIBLE_GROUPS = (0, 1, 2)
"""Geom groups that are drawn; MuJoCo's convention keeps collision shapes in the others."""


@dataclass(frozen=True)
class Hits:
    """Where rays first meet a geom; R rays."""

    distance: np.ndarray
    """Along the ray [m], infinite for a miss, shape [R]."""
    geom: np.ndarray
    """Geom id, -1 for a miss, shape [R]."""
    normal: np.ndarray
    """Unit outward normal, world frame, zero for a miss, shape [R, 3]."""


class RayCaster:
    """Holds a batch of ``frames`` states of a model and casts rays at each of them."""

    def __init__(self, model: mujoco.MjModel, frames: int, *, hidden: np.ndarray, threads: int = 0):
        """
        Args:
            model: it is copied.
            frames: how many states at once.
            hidden: geoms that rays ignore, shape [ngeom] bool.
            threads: 0 means all CPUs.
        """
        model = copy.copy(model)
        model.geom_matid[hidden] = -1
        model.geom_rgba[hidden, 3] = 0.0
        shown = ~hidden
        model.geom_rgba[shown, 3] = 1.0
        model.geom_matid[shown] = -1
        self.model = model
        self.frames = frames
        threads = threads or os.cpu_count() or 1
        self._copies = max(1, 4 * threads // frames)
        self._batch = Batch(model, frames * self._copies, threads)
        self._data = mujoco.MjData(model)
        self._shown = shown

    def pose(
        self, qpos: np.ndarray, mocap: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Set the states.

        Args:
            qpos: shape [F, nq], F at most ``frames``.
            mocap: poses of the mocap bodies, shape [F, nmocap, 7], or None for the model's.

        Returns:
            centres: of the geoms [m], shape [F, ngeom, 3]; rotations: world from geom, shape [F, ngeom, 3, 3];
            radii: of the geoms' bounding spheres [m], infinite for planes and zero for hidden ones, shape [ngeom].
        """
        count, model, data = len(qpos), self.model, self._data
        centres = np.empty((count, model.ngeom, 3))
        rotations = np.empty((count, model.ngeom, 3, 3))
        bound = self._batch.bind("qpos").reshape(self.frames, self._copies, -1)
        bound[:count] = qpos[:, None]
        if mocap is not None and model.nmocap:
            positions = self._batch.bind("mocap_pos").reshape(self.frames, self._copies, -1, 3)
            quaternions = self._batch.bind("mocap_quat").reshape(self.frames, self._copies, -1, 4)
            positions[:count] = mocap[:, None, :, :3]
            quaternions[:count] = mocap[:, None, :, 3:]
        for i in range(count):
            data.qpos[:] = qpos[i]
            if mocap is not None and model.nmocap:
                data.mocap_pos[:], data.mocap_quat[:] = mocap[i, :, :3], mocap[i, :, 3:]
            mujoco.mj_kinematics(model, data)
            centres[i] = data.geom_xpos
            rotations[i] = data.geom_xmat.reshape(-1, 3, 3)
        radii = np.where(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, np.inf, model.geom_rbound)
        return centres, rotations, np.where(self._shown, radii, 0.0)

    def cast(
        self, origins: Sequence[np.ndarray], directions: Sequence[np.ndarray], *, normals: bool = True
    ) -> list[Hits]:
        """Cast rays at each state; the number of rays may differ from one to the next.

        Args:
            origins: per state, [m], world frame, shape [R, 3] or [3].
            directions: per state, unit, world frame, shape [R, 3].
            normals: whether the normals are wanted; without them they are an empty array.
        """
        copies = self._copies
        counts = [len(d) for d in directions]
        longest = -(-max(counts, default=0) // copies)
        if longest == 0:
            empty = Hits(np.empty(0), np.empty(0, np.int32), np.empty((0, 3)))
            return [empty] * len(counts)
        n = len(counts)
        start = np.full((n, longest * copies, 3), 1e6)
        toward = np.tile(np.array([0.0, 0.0, 1.0]), (n, longest * copies, 1))
        for i, count in enumerate(counts):
            start[i, :count] = origins[i]
            toward[i, :count] = directions[i]
        shape = (n * copies, longest, 3)
        ids = np.arange(n * copies)
        found = self._batch.ray(start.reshape(shape), toward.reshape(shape), ids=ids, normal=normals)
        distance = found[0].reshape(n, -1)
        geom = found[1].reshape(n, -1)
        normal = found[2].reshape(n, -1, 3) if normals else np.empty((n, 0, 3))
        distance = np.where(geom < 0, np.inf, distance)
        return [Hits(distance[i, :c], geom[i, :c], normal[i, :c]) for i, c in enumerate(counts)]


def hidden_geoms(model: mujoco.MjModel, colours: np.ndarray, *, ground: bool) -> np.ndarray:
    """Geoms that are not drawn: those of groups 3 and above, those with no opacity in any frame, and planes if the
    renderer draws a ``ground`` of its own. colours: shape [..., ngeom, 4]. Returns shape [ngeom] bool."""
    opacity = colours[..., 3].reshape(-1, model.ngeom).max(0) if model.ngeom else np.empty(0)
    hidden = ~np.isin(model.geom_group, VISIBLE_GROUPS) | (opacity <= 0.0)
    if ground:
        hidden |= model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    return hidden


def seen_tiles(camera: Camera, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Tiles of the picture in which some sphere may appear. centres: [m], shape [S, 3]; radii: [m], shape [S].
    Returns shape [tile rows, tile columns] bool."""
    directions = camera.directions(tile_centres(camera)).reshape(-1, 3)
    reach = 0.75 * TILE / camera.focal
    return _near_line(np.asarray(camera.position), directions, centres, radii, reach).reshape(
        tile_shape(camera)
    )


def shadowed_tiles(points: np.ndarray, widths: np.ndarray, light: np.ndarray, spread: float, centres: np.ndarray,
                   radii: np.ndarray) -> np.ndarray:  # fmt: skip
    """Which points have some sphere between them and the light.

    Args:
        points: [m], world frame, shape [P, 3].
        widths: a point stands for all points so near [m], shape [P].
        light: unit vector towards the light, shape [3].
        spread: tangent of the light's angular radius.
        centres: [m], shape [S, 3].
        radii: [m], shape [S].

    Returns:
        shape [P] bool.
    """
    offset = centres[None] - points[:, None]
    along = offset @ light
    across = np.sqrt(np.maximum(np.sum(offset**2, -1) - along**2, 0.0))
    grown = radii + widths[:, None]
    return np.any((radii > 0) & (along > -grown) & (across < grown + spread * np.maximum(along, 0.0)), axis=1)


def tile_shape(camera: Camera) -> tuple[int, int]:
    """Rows and columns of tiles that cover the picture."""
    return -(-camera.height // TILE), -(-camera.width // TILE)


def tile_centres(camera: Camera) -> np.ndarray:
    """Image points (u, v) in the middle of each tile, shape [rows, columns, 2]."""
    rows, columns = tile_shape(camera)
    u = np.arange(columns) * TILE + 0.5 * (TILE - 1)
    v = np.arange(rows) * TILE + 0.5 * (TILE - 1)
    return np.stack(np.meshgrid(u, v), axis=-1)


def spread_tiles(tiles: np.ndarray, camera: Camera) -> np.ndarray:
    """A value per tile as a value per pixel, shape [height, width]."""
    return tiles.repeat(TILE, 0).repeat(TILE, 1)[: camera.height, : camera.width]


def _near_line(
    origin: np.ndarray, directions: np.ndarray, centres: np.ndarray, radii: np.ndarray, reach: float
) -> np.ndarray:
    offset = centres - origin
    along = directions @ offset.T
    across = np.maximum(np.sum(offset**2, -1) - along**2, 0.0)
    grown = radii + reach * np.maximum(along, 0.0)
    return np.any((radii > 0) & (across < grown**2) & (along > -radii), axis=1)
