"""Surfaces of MuJoCo geoms for rendering: triangle meshes with smooth normals, colors and gloss."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np

Color = tuple[float, float, float]
"""sRGB, each from 0 to 1."""

VISIBLE_GROUPS = (0, 1, 2)
"""Geom groups that are rendered; by MuJoCo's convention other groups have collision shapes."""

SEGMENTS = 48
"""Number of segments in the circumference of round primitives."""

CREASE = float(np.cos(np.radians(38.0)))
"""Cosine of the angle between triangle normals beyond which their edge is visible."""


@dataclass(frozen=True)
class SurfaceMesh:
    """A triangle mesh with V vertices and T triangles."""

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
    """Texture, sRGB from 0 to 1, shape [H, W, 3]; its linear light multiplies the color."""
    corner_uv: np.ndarray | None = None
    """Texture coordinates (u, v) of the triangles' corners, v up, shape [T, 3, 2]."""

    def moved(self, position: np.ndarray, rotation: np.ndarray) -> SurfaceMesh:
        """Return the surface after a rigid motion. position: [m], shape [3]; rotation: shape [3, 3]."""
        vertices = self.vertices @ rotation.T + position
        normals = self.corner_normals @ rotation.T.astype(np.float32)
        return replace(self, vertices=vertices, corner_normals=normals)

    def albedo(self, triangles: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Return linear colors at points of the surface, shape [P, 3]."""
        color = self.color
        if color.ndim == 2:
            color = np.einsum("pc,pci->pi", barycentric, color[self.faces[triangles]])
        if self.texture is None or self.corner_uv is None:
            return np.broadcast_to(color, (len(triangles), 3))
        place = np.einsum("pc,pci->pi", barycentric, self.corner_uv[triangles])
        return color * linear(sample_image(self.texture, place))


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals at the triangles' corners, smooth except across creases, shape [T, 3, 3] float32.

    A corner's normal is the area-weighted mean over the triangles at its vertex that are not across a crease.
    """
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = weighted / np.maximum(np.linalg.norm(weighted, axis=-1, keepdims=True), 1e-300)
    vertex, triangle = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    # Corners sorted by vertex: those of vertex i begin at first[i].
    order, counts = np.argsort(vertex, kind="stable"), np.bincount(vertex)
    first = np.cumsum(counts) - counts
    total = np.zeros((len(vertex), 3))
    for k in range(int(counts.max())):
        rows = np.flatnonzero(counts[vertex] > k)
        other = triangle[order[first[vertex[rows]] + k]]
        similar = np.einsum("...i,...i->...", flat[other], flat[triangle[rows]]) > CREASE
        total[rows] += np.where(similar[:, None], weighted[other], 0.0)
    size = np.linalg.norm(total, axis=-1, keepdims=True)
    normals = np.where(size > 1e-300, total / np.maximum(size, 1e-300), flat[triangle])
    return normals.reshape(-1, 3, 3).astype(np.float32)


@lru_cache(64)
def _kept_normals(vertices: bytes, faces: bytes) -> np.ndarray:
    """Cache ``corner_normals`` for meshes that are rendered repeatedly."""
    return corner_normals(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, int).reshape(-1, 3))


def sample_image(image: np.ndarray, texture: np.ndarray) -> np.ndarray:
    """Sample a repeated image bilinearly, shape [P, C]. image: shape [H, W, C]; texture: (u, v), v up, shape
    [P, 2]."""
    height, width = image.shape[:2]
    x = np.clip(np.mod(texture[:, 0], 1.0 + 1e-9) * width - 0.5, 0, width - 1)
    y = np.clip((1.0 - np.mod(texture[:, 1], 1.0 + 1e-9)) * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[:, None].astype(np.float32), (y - y0)[:, None].astype(np.float32)
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    return top * (1 - fy) + (image[y1, x0] * (1 - fx) + image[y1, x1] * fx) * fy


@dataclass(frozen=True)
class Materials:
    """Colors and gloss of a model's geoms."""

    colors: np.ndarray
    """sRGB and opacity, shape [ngeom, 4]."""
    specular: np.ndarray
    """Strength of the highlight, shape [ngeom]."""
    shininess: np.ndarray
    """Exponent of the highlight, shape [ngeom]."""


def model_materials(model: mujoco.MjModel) -> Materials:
    """Return a model's materials. A geom with the default color has the color of its material."""
    colors = model.geom_rgba.astype(np.float32).copy()
    specular = np.full(model.ngeom, 0.35, np.float32)
    shininess = np.full(model.ngeom, 40.0, np.float32)
    material = model.geom_matid
    has = material >= 0
    plain = has & np.all(np.abs(colors - [0.5, 0.5, 0.5, 1.0]) < 1e-6, axis=1)
    colors[plain] = model.mat_rgba[material[plain]]
    specular[has] = model.mat_specular[material[has]]
    shininess[has] = np.maximum(128.0 * model.mat_shininess[material[has]], 1.0)
    return Materials(colors, specular, shininess)


def linear(color: np.ndarray) -> np.ndarray:
    """Convert sRGB to linear light, any shape, 0 to 1."""
    color = np.asarray(color, dtype=np.float32)
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def drawn_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return the geoms to render, shape [ngeom] bool: those of ``VISIBLE_GROUPS`` except planes (there is a
    table top) and height fields."""
    left_out = [mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_PLANE]
    return np.isin(model.geom_group, VISIBLE_GROUPS) & ~np.isin(model.geom_type, left_out)


def geom_surface(model: mujoco.MjModel, geom: int, materials: Materials) -> SurfaceMesh:
    """Return the surface of a geom in its own frame."""
    mesh = int(model.geom_dataid[geom])
    texture, uv = None, None
    if mesh >= 0:
        vertices, faces, uv = _mesh(model, mesh)
        texture = texture_image(model, geom) if uv is not None else None
    else:
        vertices, faces = _primitive(mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom])
    return SurfaceMesh(
        vertices,
        faces,
        _kept_normals(vertices.tobytes(), faces.astype(int).tobytes()),
        linear(materials.colors[geom, :3]),
        float(materials.specular[geom]),
        float(materials.shininess[geom]),
        texture,
        uv,
    )


def texture_image(model: mujoco.MjModel, geom: int) -> np.ndarray | None:
    """Return the color texture of a geom's material, sRGB from 0 to 1, shape [H, W, 3], or None."""
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


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return merged vertices, faces, and texture coordinates of the corners."""
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[start : start + count].astype(float)
    _, first, welded = np.unique(np.round(vertices, 7), axis=0, return_index=True, return_inverse=True)
    face_start, face_count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = welded.ravel()[model.mesh_face[face_start : face_start + face_count]]
    uv_start, uv = int(model.mesh_texcoordadr[mesh]), None
    if uv_start >= 0:
        index = model.mesh_facetexcoord[face_start : face_start + face_count]
        uv = model.mesh_texcoord[uv_start:][index].astype(float)
    return vertices[first], faces, uv


def _primitive(kind: mujoco.mjtGeom, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a primitive, with z along its axis."""
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_BOX:
        corners = size * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
        quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
        return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SEGMENTS // 2 + 1)
    radius, height = np.cos(angle), np.sin(angle)
    radius[[0, -1]] = 0.0
    if kind == shapes.mjGEOM_CAPSULE:
        middle = SEGMENTS // 4
        radius, height = (size[0] * np.insert(a, middle, a[middle]) for a in (radius, height))
        height += np.where(np.arange(len(height)) > middle, size[1], -size[1])
        return _revolved(radius, height)
    if kind == shapes.mjGEOM_CYLINDER:
        return _revolved(size[0] * np.array([0.0, 1.0, 1.0, 0.0]), size[1] * np.array([-1.0, -1.0, 1.0, 1.0]))
    vertices, faces = _revolved(radius, height)
    return vertices * (size if kind == shapes.mjGEOM_ELLIPSOID else size[0]), faces


def _revolved(radius: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a surface of revolution about z. radius, height: profile from low to high, shape [K]."""
    turn = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    rings = np.stack(np.broadcast_arrays(np.cos(turn), np.sin(turn), 1.0), axis=-1)
    vertices = rings * np.stack([radius, radius, height], axis=-1)[:, None]
    row, column = np.mgrid[: len(radius) - 1, :SEGMENTS]
    a, b = row * SEGMENTS + column, row * SEGMENTS + (column + 1) % SEGMENTS
    faces = np.stack([a, b, b + SEGMENTS, a, b + SEGMENTS, a + SEGMENTS], axis=-1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces
