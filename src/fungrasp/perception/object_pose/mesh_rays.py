"""Depth images of a mesh by ray casting, for judging many poses of it: no display, no GPU.

Camera frame: OpenCV (x right, y down, z forward) [m].
"""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.geometry.poses import rotation_matrix

FARTHEST = 30.0
"""Rays end here [m]."""


class MeshRays:
    """A triangle mesh that rays can meet, from outside and from inside."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        """
        Args:
            vertices: [m], shape [V, 3], mesh frame.
            faces: vertex indices, outward, shape [F, 3].
        """
        spec = mujoco.MjSpec()
        spec.add_mesh(
            name="mesh",
            uservert=np.asarray(vertices, dtype=float).ravel(),
            userface=np.asarray(faces, dtype=np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)

    def cast(self, poses: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Depth images of the mesh in several poses.

        Args:
            poses: mesh in the camera frame, shape [H, 7].
            directions: of the rays from the camera's centre, with z = 1, shape [R, 3].

        Returns:
            depth along the optical axis [m], infinite where the mesh is missed, shape [H, R].
        """
        count = len(directions)
        lengths = np.linalg.norm(directions, axis=-1)
        units = directions / lengths[:, None]
        depth = np.empty((len(poses), count))
        geom, distance = np.empty(count, np.int32), np.empty(count)
        for i, rotation in enumerate(rotation_matrix(poses[:, 3:])):
            eye, towards = -rotation.T @ poses[i, :3], (units @ rotation).ravel()
            mujoco.mj_multiRay(
                self._model, self._data, eye, towards, None, True, -1, geom, distance, None, count, FARTHEST
            )
            depth[i] = np.where(geom >= 0, distance / lengths, np.inf)
        return depth
