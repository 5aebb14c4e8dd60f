"""What the ray caster does not tell about a mesh: its smooth normals and texture where a ray met it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import KDTree

CREASE = float(np.cos(np.radians(38.0)))
"""Faces whose normals differ by more than this angle meet in a visible edge (cosine)."""


@dataclass(frozen=True)
class MeshSurface:
    """A triangle mesh ready to be asked for its smooth attributes; T triangles."""

    corners: np.ndarray
    """[m], mesh frame, shape [T, 3, 3]."""
    corner_normals: np.ndarray
    """Unit, smooth across soft edges, shape [T, 3, 3]."""
    corner_texture: np.ndarray | None
    """Texture coordinates, shape [T, 3, 2], or None."""
    planes: KDTree
    """Finds triangles by the plane they lie in."""
    scale: float
    """Metres that weigh as much as one unit of normal in ``planes``."""

    def lookup(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Smooth normals and texture coordinates at surface points.

        Args:
            points: [m], mesh frame, shape [P, 3].
            normals: flat normals of the triangles the points lie on, mesh frame, shape [P, 3].

        Returns:
            unit normals, shape [P, 3]; texture coordinates, shape [P, 2], or None.
        """
        key = np.concatenate([normals, (dot(points, normals) / self.scale)[:, None]], axis=1)
        cells = np.round(key * 2000.0).astype(np.int64) + 8192
        packed = ((cells[:, 0] << 14 | cells[:, 1]) << 14 | cells[:, 2]) << 18 | cells[:, 3]
        _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
        rank = min(12, len(self.corners))
        _, candidates = self.planes.query(key[first], k=rank)
        candidates = candidates.reshape(len(first), rank)
        best = np.full(len(points), -np.inf)
        weights = np.zeros((len(points), 3))
        face = np.zeros(len(points), np.intp)
        open_points = np.arange(len(points))
        for k in range(rank):
            here = candidates[inverse[open_points], k]
            found = _barycentric(points[open_points], self.corners[here])
            inside = found.min(-1)
            better = inside > best[open_points]
            rows = open_points[better]
            best[rows], weights[rows], face[rows] = inside[better], found[better], here[better]
            open_points = open_points[best[open_points] < -1e-3]
            if not len(open_points):
                break
        weights = np.clip(weights, 0.0, 1.0)
        weights /= weights.sum(-1, keepdims=True)
        normal = np.einsum("pc,pci->pi", weights, self.corner_normals[face])
        normal /= np.sqrt(dot(normal, normal)[:, None])
        if self.corner_texture is None:
            return normal, None
        return normal, np.einsum("pc,pci->pi", weights, self.corner_texture[face])


def mesh_surface(model: mujoco.MjModel, mesh: int) -> MeshSurface:
    """Prepare mesh number ``mesh`` of a model."""
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[start : start + count].astype(float)
    face_start, face_count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[face_start : face_start + face_count]
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.sqrt(dot(weighted, weighted)[:, None])
    flat = weighted / np.maximum(area, 1e-300)
    texture = None
    texture_start = int(model.mesh_texcoordadr[mesh])
    if texture_start >= 0:
        index = model.mesh_facetexcoord[face_start : face_start + face_count]
        texture = model.mesh_texcoord[texture_start:][index].astype(float)
    scale = 0.25 * float(np.ptp(vertices, axis=0).max())
    key = np.concatenate([flat, (dot(corners[:, 0], flat) / scale)[:, None]], axis=1)
    return MeshSurface(corners, _smooth_normals(vertices, faces, flat, weighted), texture, KDTree(key), scale)


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


def sample_image(image: np.ndarray, texture: np.ndarray) -> np.ndarray:
    """Bilinear look-up that repeats the image. image: shape [H, W, C]; texture: (u, v), v up, shape [P, 2].
    Returns [P, C].
    """
    height, width = image.shape[:2]
    x = np.clip(np.mod(texture[:, 0], 1.0 + 1e-9) * width - 0.5, 0, width - 1)
    y = np.clip((1.0 - np.mod(texture[:, 1], 1.0 + 1e-9)) * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[:, None].astype(np.float32), (y - y0)[:, None].astype(np.float32)
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    return top * (1 - fy) + (image[y1, x0] * (1 - fx) + image[y1, x1] * fx) * fy


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products over the last axis; the shapes are equal."""
    return np.einsum("...i,...i->...", a, b)


def _smooth_normals(
    vertices: np.ndarray, faces: np.ndarray, flat: np.ndarray, weighted: np.ndarray
) -> np.ndarray:
    _, welded = np.unique(np.round(vertices, 7), axis=0, return_inverse=True)
    corner_vertex = welded.ravel()[faces].ravel()
    corner_face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner_vertex, kind="stable")
    counts = np.bincount(corner_vertex)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    result = np.zeros((len(corner_vertex), 3))
    for k in range(int(counts.max())):
        has = counts[corner_vertex] > k
        other = corner_face[order[first[corner_vertex[has]] + k]]
        similar = dot(flat[other], flat[corner_face[has]]) > CREASE
        result[has] += np.where(similar[:, None], weighted[other], 0.0)
    norm = np.sqrt(dot(result, result)[:, None])
    result = np.where(norm > 1e-300, result / np.maximum(norm, 1e-300), flat[corner_face])
    return result.reshape(-1, 3, 3)


def _barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
    pa, pb = dot(p, a), dot(p, b)
    denominator = np.maximum(aa * bb - ab * ab, 1e-300)
    v, w = (bb * pa - ab * pb) / denominator, (aa * pb - ab * pa) / denominator
    return np.stack([1.0 - v - w, v, w], axis=-1)
