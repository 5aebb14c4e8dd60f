"""Ray casting of many states of a model on the CPU threads of ``mujoco.batch``: no display, OpenGL or GPU."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

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
    """Holds a batch of simulations of one model; each holds a state, or shares the rays of one with others."""

    def __init__(self, model: mujoco.MjModel, simulations: int, *, drawn: np.ndarray, threads: int = 0):
        """
        Args:
            model: it is copied.
            simulations: the largest number of states at once.
            drawn: geoms that rays meet, shape [ngeom] bool.
            threads: 0 means all CPUs.
        """
        model = copy.copy(model)
        model.geom_matid[:] = -1
        model.geom_rgba[:, 3] = drawn
        self._model = model
        self._batch = Batch(model, simulations, threads)
        self._opacity = self._batch.expand("geom_rgba") if model.ngeom else np.empty((simulations, 0, 4))
        self._data = mujoco.MjData(model)
        plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self._radii = np.where(plane, np.inf, model.geom_rbound)
        self._states = 1

    def pose(
        self, qpos: np.ndarray, mocap: np.ndarray | None, visible: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Set the states.

        Args:
            qpos: shape [F, nq].
            mocap: poses of the mocap bodies, shape [F, nmocap, 7], or None for the model's.
            visible: geoms that rays meet, shape [F, ngeom] bool.

        Returns:
            centres: of the geoms [m], shape [F, ngeom, 3]; rotations: world from geom, shape [F, ngeom, 3, 3];
            radii: of bounding spheres [m], infinite for planes, 0 for what is not visible, shape [F, ngeom].
        """
        count, model, data = len(qpos), self._model, self._data
        self._states, copies = count, self._batch.nsim // count
        used = count * copies
        self._batch.bind("qpos")[:used] = qpos.repeat(copies, 0)
        self._opacity[:used, :, 3] = visible.repeat(copies, 0)
        has_mocap = model.nmocap > 0 and mocap is not None
        if has_mocap:
            self._batch.bind("mocap_pos")[:used] = mocap[..., :3].repeat(copies, 0)
            self._batch.bind("mocap_quat")[:used] = mocap[..., 3:].repeat(copies, 0)
        centres, rotations = np.empty((count, model.ngeom, 3)), np.empty((count, model.ngeom, 3, 3))
        for i in range(count):
            data.qpos[:] = qpos[i]
            if has_mocap:
                data.mocap_pos[:], data.mocap_quat[:] = mocap[i, :, :3], mocap[i, :, 3:]
            mujoco.mj_kinematics(model, data)
            centres[i], rotations[i] = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        return centres, rotations, np.where(visible, self._radii, 0.0)

    def cast(self, rays: Sequence[tuple[np.ndarray, np.ndarray]], *, normals: bool = True) -> list[Hits]:
        """Cast rays at each state; their number may differ from one to the next.

        Args:
            rays: per state, origins [m], shape [R, 3] or [3], and unit directions, shape [R, 3]; world frame.
            normals: whether the normals are wanted; without, they are an empty array.
        """
        copies = self._batch.nsim // self._states
        counts = [len(directions) for _, directions in rays]
        longest = -(-max(counts) // copies)
        if longest == 0:
            nothing = Hits(np.empty(0), np.empty(0, np.int32), np.empty((0, 3)))
            return [nothing] * len(counts)
        used = len(counts) * copies
        start, towards = np.empty((2, len(counts), longest * copies, 3))
        for i, (origins, directions) in enumerate(rays):
            start[i, : counts[i]], towards[i, : counts[i]] = origins, directions
            start[i, counts[i] :], towards[i, counts[i] :] = 1e6, (0.0, 0.0, 1.0)
        shape = (used, longest, 3)
        found = self._batch.ray(
            start.reshape(shape), towards.reshape(shape), ids=np.arange(used), normal=normals
        )
        distance, geom = (array.reshape(len(counts), -1) for array in found[:2])
        normal = found[2].reshape(len(counts), -1, 3) if normals else np.empty((len(counts), 0, 3))
        distance = np.where(geom < 0, np.inf, distance)
        return [Hits(distance[i, :c], geom[i, :c], normal[i, :c]) for i, c in enumerate(counts)]


def drawn_geoms(model: mujoco.MjModel, *, ground: bool) -> np.ndarray:
    """Geoms that may be drawn: those of ``VISIBLE_GROUPS``, but no planes if the renderer draws a ``ground`` of its
    own. Returns shape [ngeom] bool."""
    drawn = np.isin(model.geom_group, VISIBLE_GROUPS)
    return drawn & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) if ground else drawn


def seen_tiles(camera: Camera, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Tiles of the picture in which some sphere may appear. centres: [m], shape [S, 3]; radii: [m], shape [S].
    Returns shape [tile rows, tile columns] bool."""
    directions = camera.directions(tile_centres(camera)).reshape(-1, 3)
    reach = 0.75 * TILE / camera.focal
    return _near_line(np.asarray(camera.position), directions, centres, radii, reach).reshape(
        tile_shape(camera)
    )


def blocked(
    points: np.ndarray,
    widths: np.ndarray,
    light: np.ndarray,
    spread: float,
    centres: np.ndarray,
    radii: np.ndarray,
) -> np.ndarray:
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
