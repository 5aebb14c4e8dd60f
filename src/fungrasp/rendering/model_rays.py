"""Ray casting of many states of a model on the CPU threads of ``mujoco.batch``: no display, OpenGL or GPU."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from fungrasp.rendering.tile_culling import Boxes

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
    """Holds a batch of simulations of one model; each holds a state, or shares the rays of one with
    others.
    """

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
        self._plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self._states = 1

    def pose(
        self, qpos: np.ndarray, mocap: np.ndarray | None, visible: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[Boxes]]:
        """Set the states.

        Args:
            qpos: shape [F, nq].
            mocap: poses of the mocap bodies, shape [F, nmocap, 7], or None for the model's.
            visible: geoms that rays meet, shape [F, ngeom] bool.

        Returns:
            centres: of the geoms [m], shape [F, ngeom, 3]; rotations: world from geom, [F, ngeom, 3, 3];
            boxes: around what is visible in each state.
        """
        count, model, data = len(qpos), self._model, self._data
        self._states, copies = count, self._batch.nsim // count
        used = count * copies
        self._batch.bind("qpos")[:used] = qpos.repeat(copies, 0)
        self._opacity[:used, :, 3] = visible.repeat(copies, 0)
        if mocap is not None:
            self._batch.bind("mocap_pos")[:used] = mocap[..., :3].repeat(copies, 0)
            self._batch.bind("mocap_quat")[:used] = mocap[..., 3:].repeat(copies, 0)
        centres, rotations = np.empty((count, model.ngeom, 3)), np.empty((count, model.ngeom, 3, 3))
        for i in range(count):
            data.qpos[:] = qpos[i]
            if mocap is not None:
                data.mocap_pos[:], data.mocap_quat[:] = mocap[i, :, :3], mocap[i, :, 3:]
            mujoco.mj_kinematics(model, data)
            centres[i], rotations[i] = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        return (
            centres,
            rotations,
            [self._boxes(*state) for state in zip(centres, rotations, visible, strict=True)],
        )

    def _boxes(self, centres: np.ndarray, rotations: np.ndarray, visible: np.ndarray) -> Boxes:
        bounded = visible & ~self._plane
        bounds = self._model.geom_aabb[bounded]
        middle = centres[bounded] + np.einsum("bij,bj->bi", rotations[bounded], bounds[:, :3])
        return Boxes(middle, rotations[bounded], bounds[:, 3:], bool(np.any(visible & self._plane)))

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
    """Geoms that may be drawn: those of ``VISIBLE_GROUPS``, but no planes if the renderer draws a ``ground``
    of its own. Returns shape [ngeom] bool."""
    drawn = np.isin(model.geom_group, VISIBLE_GROUPS)
    return drawn & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) if ground else drawn
