"""Triangle meshes with what their looks depend on: smooth normals, colors, texture, gloss."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fungrasp.media.shading import dot, linear

CREASE = float(np.cos(np.radians(38.0)))
"""Triangles whose normals differ by more than this angle meet in a visible edge (cosine)."""


@dataclass(frozen=True)
class SurfaceMesh:
    """A triangle mesh to be drawn; V vertices, T triangles."""

    vertices: np.ndarray
    """Positions of the vertices [m], world frame, shape [V, 3]."""
    faces: np.ndarray
    """Vertex indices, counter-clockwise from outside, shape [T, 3]."""
    corner_normals: np.ndarray
    """Unit normals at the triangles' corners, world frame, shape [T, 3, 3]."""
    color: np.ndarray
    """Linear color of the whole mesh or of each vertex, shape [3] or [V, 3]."""
    specular: float = 0.1
    """Strength of the highlight."""
    shininess: float = 10.0
    """Exponent of the highlight."""
    texture: np.ndarray | None = None
    """sRGB image, from 0 to 1, whose linear light multiplies the color, shape [H, W, 3]."""
    corner_uv: np.ndarray | None = None
    """Texture coordinates (u, v) of the triangles' corners, v up, shape [T, 3, 2]."""

    def moved(self, position: np.ndarray, rotation: np.ndarray) -> SurfaceMesh:
        """The surface after a rigid motion. position: [m], shape [3]; rotation: shape [3, 3]."""
        vertices = self.vertices @ rotation.T + position
        normals = self.corner_normals @ rotation.T.astype(np.float32)
        return replace(self, vertices=vertices, corner_normals=normals)

    def normals(self, triangles: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Smooth normals at points of the surface, not of unit length, shape [P, 3]."""
        return np.einsum("pc,pci->pi", barycentric, self.corner_normals[triangles])

    def albedo(self, triangles: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Linear colors at points of the surface, shape [P, 3]."""
        color = self.color
        if color.ndim == 2:
            color = np.einsum("pc,pci->pi", barycentric, color[self.faces[triangles]])
        if self.texture is None or self.corner_uv is None:
            return np.broadcast_to(color, (len(triangles), 3))
        place = np.einsum("pc,pci->pi", barycentric, self.corner_uv[triangles])
        return color * linear(sample_image(self.texture, place))


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals at the triangles' corners, smooth except across creases, shape [T, 3, 3] float32.

    A corner's normal is the mean, by area, over the triangles at its vertex that are not across a crease.
    """
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = weighted / np.maximum(np.linalg.norm(weighted, axis=-1, keepdims=True), 1e-300)
    vertex, triangle = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    # Corners in the order of their vertices: those of vertex i begin at first[i].
    order, counts = np.argsort(vertex, kind="stable"), np.bincount(vertex)
    first = np.cumsum(counts) - counts
    total = np.zeros((len(vertex), 3))
    for k in range(int(counts.max())):
        rows = np.flatnonzero(counts[vertex] > k)
        other = triangle[order[first[vertex[rows]] + k]]
        similar = dot(flat[other], flat[triangle[rows]]) > CREASE
        total[rows] += np.where(similar[:, None], weighted[other], 0.0)
    size = np.linalg.norm(total, axis=-1, keepdims=True)
    normals = np.where(size > 1e-300, total / np.maximum(size, 1e-300), flat[triangle])
    return normals.reshape(-1, 3, 3).astype(np.float32)


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
