"""Depth images of a mesh, for judging many poses of it.

Camera frame: OpenCV (x right, y down, z forward) [m].
"""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import rotation_matrix
from fungrasp.geometry.ray_casting import RayCaster


class MeshRays:
    """A triangle mesh that can be looked at in many poses."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        """
        Args:
            vertices: [m], shape [V, 3], mesh frame.
            faces: vertex indices, shape [F, 3].
        """
        self._caster = RayCaster([(vertices, faces)])

    def cast(self, poses: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Depth images of the mesh in several poses.

        Args:
            poses: mesh in the camera frame, shape [H, 7].
            directions: of the rays from the camera's centre, with z = 1, shape [R, 3].

        Returns:
            depth along the optical axis [m], infinite where the mesh is missed, shape [H, R].
        """
        lengths = np.linalg.norm(directions, axis=-1)
        units = directions / lengths[:, None]
        depth = np.empty((len(poses), len(directions)))
        for i, rotation in enumerate(rotation_matrix(poses[:, 3:])):
            depth[i] = self._caster.cast(-rotation.T @ poses[i, :3], units @ rotation).distance / lengths
        return depth
