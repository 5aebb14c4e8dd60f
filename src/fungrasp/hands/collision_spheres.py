"""A hand's collision shapes as spheres, dense enough for distances; the depth of its contacts with itself."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
import trimesh

from fungrasp.geometry.signed_distance import points_on_triangles
from fungrasp.hands.hand import Hand
from fungrasp.hands.kinematics import BodyPoints


class CollisionSpheres(NamedTuple):
    """Spheres whose union covers the hand's collision geometry."""

    points: BodyPoints
    """Centers of the P spheres, each fixed to a body."""
    radius: np.ndarray
    """Radius [m], shape [P]; zero for points on a flat surface."""
    link: np.ndarray
    """Index into ``Hand.links``, shape [P]."""
    geom: np.ndarray
    """Geom id in the bare hand's model, shape [P]."""


@lru_cache(maxsize=64)
def collision_spheres(hand: Hand, spacing: float = 0.012) -> CollisionSpheres:
    """Cover the collision geoms of a hand with spheres; made once for each hand and spacing.

    Spheres and capsules are covered by spheres of their own radius along their axis; boxes, cylinders,
    ellipsoids and the convex hulls of meshes by points on their surface.

    Args:
        hand: any hand.
        spacing: largest gap between neighbors [m]; along a capsule three quarters of its radius, if that is
            less.
    """
    model = hand.model
    link_of_body = {name: i for i, members in enumerate(hand.links) for name in members}
    bodies, offsets, radii, links, geoms = [], [], [], [], []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body == 0 or not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        local, radius = _cover(model, geom, spacing)
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        offsets.append(model.geom_pos[geom] + local @ rotation.reshape(3, 3).T)
        bodies += [body] * len(local)
        radii += [radius] * len(local)
        links += [link_of_body[model.body(body).name]] * len(local)
        geoms += [geom] * len(local)
    points = BodyPoints(np.array(bodies), np.concatenate(offsets))
    return CollisionSpheres(points, np.array(radii), np.array(links), np.array(geoms))


def self_collision_depth(model: mujoco.MjModel, joint_positions: np.ndarray) -> np.ndarray:
    """Deepest contact of the hand with itself, by MuJoCo's own collision detection.

    Args:
        model: the bare hand's, ``Hand.model``.
        joint_positions: [rad], shape [N, M].

    Returns:
        [m], shape [N]; zero without a contact.
    """
    data = mujoco.MjData(model)
    depths = np.zeros(len(joint_positions))
    for row, qpos in enumerate(joint_positions):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        depths[row] = max((-contact.dist for contact in data.contact), default=0.0)
    return np.maximum(depths, 0.0)


def _cover(model: mujoco.MjModel, geom: int, spacing: float) -> tuple[np.ndarray, float]:
    kind, size = model.geom_type[geom], model.geom_size[geom]
    types = mujoco.mjtGeom
    if kind == types.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == types.mjGEOM_CAPSULE:
        count = 1 + int(np.ceil(2 * size[1] / min(spacing, 0.75 * size[0])))
        z = np.linspace(-size[1], size[1], count)
        return np.stack([np.zeros(count), np.zeros(count), z], axis=1), float(size[0])
    if kind == types.mjGEOM_BOX:
        return _box_surface(size, spacing), 0.0
    if kind == types.mjGEOM_CYLINDER:
        return _cylinder_surface(size[0], size[1], spacing), 0.0
    if kind == types.mjGEOM_ELLIPSOID:
        cube = _box_surface(np.ones(3), spacing / size.max())
        return cube / np.linalg.norm(cube, axis=1, keepdims=True) * size, 0.0
    if kind == types.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        return _hull_surface(model.mesh_vert[first : first + count].astype(float), spacing), 0.0
    raise NotImplementedError(f"collision geom type {kind}")


def _box_surface(half: np.ndarray, spacing: float) -> np.ndarray:
    axes = [np.linspace(-h, h, 1 + int(np.ceil(2 * h / spacing))) for h in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.any(np.isclose(np.abs(grid), half), axis=1)]


def _cylinder_surface(radius: float, half: float, spacing: float) -> np.ndarray:
    rings = [(radius, z) for z in np.linspace(-half, half, 1 + int(np.ceil(2 * half / spacing)))]
    inner = np.linspace(0, radius, 1 + int(np.ceil(radius / spacing)))[:-1]
    rings += [(r, z) for z in (-half, half) for r in inner]
    points = []
    for r, z in rings:
        angles = np.linspace(
            0, 2 * np.pi, max(8, int(np.ceil(2 * np.pi * r / spacing))) if r else 1, endpoint=False
        )
        points.append(np.column_stack([r * np.cos(angles), r * np.sin(angles), np.full(len(angles), z)]))
    return np.concatenate(points)


def _hull_surface(vertices: np.ndarray, spacing: float) -> np.ndarray:
    """Points on the convex hull, with which MuJoCo collides, one per cube of half the spacing."""
    hull = trimesh.convex.convex_hull(vertices)
    points, _ = points_on_triangles(np.asarray(hull.triangles), 0.5 * spacing)
    _, one_each = np.unique(np.round(points / (0.5 * spacing)).astype(int), axis=0, return_index=True)
    return points[one_each]
