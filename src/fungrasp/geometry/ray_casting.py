"""Ray casting of triangle meshes with Embree, on the CPU in single precision."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError


@dataclass(frozen=True)
class RayHits:
    """First hits of R rays, from outside or inside a mesh."""

    distance: np.ndarray
    """Distance along the ray [m], infinite for a miss, shape [R]."""
    mesh: np.ndarray
    """Index of the mesh, -1 for a miss, shape [R]."""
    triangle: np.ndarray
    """Index of the triangle in its mesh, undefined for a miss, shape [R]."""
    barycentric: np.ndarray
    """Weights of the triangle's three corners at the hit, shape [R, 3]."""


class RayCaster:
    """Ray caster for triangle meshes in one frame."""

    def __init__(self, meshes: Iterable[tuple[np.ndarray, np.ndarray]]):
        """
        Args:
            meshes: vertices [m], shape [V, 3], and faces (vertex indices), shape [T, 3], of each mesh.

        Raises:
            FungraspError: embreex is not installed.
        """
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise FungraspError(
                "casting rays needs embreex, which has no wheel for this kind of machine: build it from "
                "https://github.com/trimesh/embreex"
            ) from error
        self._scene: Any = EmbreeScene()
        for vertices, faces in meshes:
            TriangleMesh(self._scene, np.asarray(vertices, np.float32), np.asarray(faces, np.int32))

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> RayHits:
        """Return the first hits.

        Args:
            origins: [m], shape [3] or [R, 3].
            directions: unit vectors, shape [R, 3].
        """
        hits = self._scene.run(*_rays(origins, directions), query="INTERSECT", output=True)
        mesh, u, v = hits["geomID"].astype(np.int64), hits["u"], hits["v"]
        distance = np.where(mesh >= 0, hits["tfar"], np.inf)
        return RayHits(distance, mesh, hits["primID"], np.stack([1 - u - v, u, v], axis=-1))

    def free_distance(self, origins: np.ndarray, directions: np.ndarray, limit: float) -> np.ndarray:
        """Return the distance of the first hits [m], at most ``limit`` [m], shape [R]. Arguments as for
        ``cast``."""
        limits = np.full(len(directions), limit, np.float32)
        return self._scene.run(*_rays(origins, directions), query="DISTANCE", dists=limits)


def _rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    towards = np.ascontiguousarray(directions, np.float32)
    return np.broadcast_to(np.asarray(origins, np.float32), towards.shape).copy(), towards
