"""The geoms of a MuJoCo model as surfaces: meshes as they are, primitives as fine meshes."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.media.shading import Materials, linear
from fungrasp.media.surfaces import SurfaceMesh, corner_normals

VISIBLE_GROUPS = (0, 1, 2)
"""Geom groups that are drawn; MuJoCo's convention keeps collision shapes in the others."""

SEGMENTS = 48
"""Straight pieces in the circumference of a round primitive."""

INFINITE = 20.0
"""Half the side of a plane that the model gives no size [m]."""


def drawn_geoms(model: mujoco.MjModel, *, ground: bool) -> np.ndarray:
    """Geoms that may be drawn: those of ``VISIBLE_GROUPS``, but no planes if the renderer draws a ``ground``
    of its own. Height fields are not drawn. Returns shape [ngeom] bool."""
    shapes = mujoco.mjtGeom
    left_out = [shapes.mjGEOM_HFIELD, *([shapes.mjGEOM_PLANE] if ground else [])]
    return np.isin(model.geom_group, VISIBLE_GROUPS) & ~np.isin(model.geom_type, left_out)


def geom_surface(model: mujoco.MjModel, geom: int, materials: Materials) -> SurfaceMesh:
    """Surface of a geom, in the geom's own frame."""
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
        corner_normals(vertices, faces),
        linear(materials.colors[geom, :3]),
        float(materials.specular[geom]),
        float(materials.shininess[geom]),
        texture,
        uv,
    )


def texture_image(model: mujoco.MjModel, geom: int) -> np.ndarray | None:
    """The color texture of a geom's material, sRGB from 0 to 1, shape [H, W, 3], or None."""
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
    """Vertices, of which no two are in one place, faces, and texture coordinates of the corners."""
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
    """Vertices and faces of a primitive, with z along its axis."""
    shapes = mujoco.mjtGeom
    if kind in (shapes.mjGEOM_BOX, shapes.mjGEOM_PLANE):
        half = size.copy()
        if kind == shapes.mjGEOM_PLANE:
            half = np.array([*np.where(size[:2] > 0, size[:2], INFINITE), 0.0])
        corners = half * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
        quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
        quads = quads[5:] if kind == shapes.mjGEOM_PLANE else quads
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
    """Surface of revolution about z. radius, height: of its profile from low to high, shape [K]."""
    turn = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    rings = np.stack(np.broadcast_arrays(np.cos(turn), np.sin(turn), 1.0), axis=-1)
    vertices = rings * np.stack([radius, radius, height], axis=-1)[:, None]
    row, column = np.mgrid[: len(radius) - 1, :SEGMENTS]
    a, b = row * SEGMENTS + column, row * SEGMENTS + (column + 1) % SEGMENTS
    faces = np.stack([a, b, b + SEGMENTS, a, b + SEGMENTS, a + SEGMENTS], axis=-1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces
