"""Collision geometry of a hand as spheres, and self-collisions of its links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.signed_distance import points_on_triangles
from fungrasp.hands.hand import Hand
from fungrasp.hands.kinematic_tree import body_name, coupled_positions
from fungrasp.hands.kinematics import BodyPoints


class CollisionSpheres(NamedTuple):
    """Spheres that cover the hand's collision geometry."""

    points: BodyPoints
    """Centers of the P spheres, each fixed to a body."""
    radius: np.ndarray
    """Radius [m], shape [P]; zero for points on a flat surface."""
    link: np.ndarray
    """Index into ``Hand.links``, shape [P]."""
    geom: np.ndarray
    """Geom id in the bare hand's model, shape [P]."""

    def nearest(self, clearance: np.ndarray, links: int) -> tuple[np.ndarray, np.ndarray]:
        """Return index and clearance [m] of each link's nearest sphere, shape [N, L] each; infinite clearance
        for a link without spheres.

        Args:
            clearance: distances of the spheres from an object [m], shape [N, P].
            links: number of links L.
        """
        of_links = [np.where(self.link == link, clearance, np.inf) for link in range(links)]
        sphere = np.stack([each.argmin(axis=1) for each in of_links], axis=1)
        covered = np.isin(np.arange(links), self.link)
        return sphere, np.where(covered, np.take_along_axis(clearance, sphere, axis=1), np.inf)


@lru_cache(maxsize=64)
def collision_spheres(hand: Hand, spacing: float = 0.012) -> CollisionSpheres:
    """Cover the collision geoms of a hand with spheres (cached).

    Spheres and capsules are covered by spheres of their own radius along their axis; boxes, cylinders,
    ellipsoids and convex hulls of meshes by points on their surface.

    Args:
        spacing: largest distance between neighbors [m]; along a capsule at most 3/4 of its radius.
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
    """Return the depth of the deepest self-collision by MuJoCo's collision detection [m], shape [N].

    Args:
        model: model of the bare hand, ``Hand.model``.
        joint_positions: all joints [rad], shape [N, M].
    """
    data = mujoco.MjData(model)
    depths = np.zeros(len(joint_positions))
    for row, qpos in enumerate(joint_positions):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        depths[row] = max(0.0, -data.contact.dist.min(initial=0.0))
    return depths


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
    """Return points on the convex hull, MuJoCo's collision shape, one per cube of half the spacing."""
    import trimesh

    hull = trimesh.convex.convex_hull(vertices)
    points, _ = points_on_triangles(np.asarray(hull.triangles), 0.5 * spacing)
    _, one_each = np.unique(np.round(points / (0.5 * spacing)).astype(int), axis=0, return_index=True)
    return points[one_each]


DEEP = 0.002
"""Smallest reported penetration [m]."""

POSES = 200
"""Number of random poses to check for collisions."""

BY_SHAPE = 0.25
"""Links that penetrate in a larger share of random poses do so because of their shapes."""


@dataclass(frozen=True)
class SelfContact:
    """Two links that penetrate each other in some of the given poses."""

    first: str
    """Body name."""
    second: str
    """Body name."""
    depth: float
    """Depth of the deepest penetration [m]."""
    share: float
    """Share of poses with a penetration."""
    rows: tuple[int, ...]
    """Indices of these poses, the deepest penetration first."""


def self_contacts(
    model: mujoco.MjModel, joint_positions: np.ndarray, depth: float = DEEP
) -> list[SelfContact]:
    """Return pairs of links that penetrate each other, the most frequent first.

    Args:
        joint_positions: all joints [rad], shape [N, M].
        depth: largest penetration that is ignored [m].
    """
    data = mujoco.MjData(model)
    found: dict[tuple[str, str], list[tuple[float, int]]] = {}
    for row, positions in enumerate(joint_positions):
        data.qpos[:] = positions
        mujoco.mj_fwdPosition(model, data)
        deepest: dict[tuple[str, str], float] = {}
        for contact in data.contact:
            first, second = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)
            if -contact.dist > depth:
                pair = body_name(model, first), body_name(model, second)
                deepest[pair] = max(deepest.get(pair, 0.0), -float(contact.dist))
        for pair, value in deepest.items():
            found.setdefault(pair, []).append((-value, row))
    contacts = [
        SelfContact(
            *pair, -min(each)[0], len(each) / len(joint_positions), tuple(row for _, row in sorted(each))
        )
        for pair, each in found.items()
    ]
    return sorted(contacts, key=lambda contact: (-contact.share, contact.first, contact.second))


def zero_and_random_poses(model: mujoco.MjModel) -> np.ndarray:
    """Return the pose nearest to zero and ``POSES`` random ones within the limits, with coupled joints [rad],
    shape [1 + POSES, M]. model: all joints are limited."""
    low, high = model.jnt_range.T
    random = np.random.default_rng(0).uniform(low, high, (POSES, model.njnt))
    return np.stack(
        [coupled_positions(model, p) for p in (np.clip(np.zeros(model.njnt), low, high), *random)]
    )


NAMED = 5
"""Largest number of grasps or pairs of links to name in a warning."""


def self_contact_words(model: mujoco.MjModel, joint_positions: np.ndarray) -> list[str]:
    """Return warnings about self-collisions and their remedies: one for collisions caused by poses of the
    grasps, one for those caused by shapes of links.

    Args:
        joint_positions: all joints of N grasps [rad], shape [N, M].
    """
    contacts = self_contacts(model, joint_positions)
    if not contacts:
        return []
    poses = zero_and_random_poses(model)
    at_zero = {(c.first, c.second) for c in self_contacts(model, poses[:1])}
    anywhere = {(c.first, c.second): c.share for c in self_contacts(model, poses[1:])}
    shapes = [
        c
        for c in contacts
        if (c.first, c.second) in at_zero or anywhere.get((c.first, c.second), 0.0) > BY_SHAPE
    ]
    posed = [contact for contact in contacts if contact not in shapes]
    words = []
    if posed:
        worst = max(posed, key=lambda contact: contact.depth)
        rows = sorted({row for contact in posed for row in contact.rows})
        words.append(
            f"{len(rows)} of {len(joint_positions)} grasps collide with themselves, by up to "
            f"{1e3 * worst.depth:.1f} mm ({_some(rows)}; '{worst.first}' and '{worst.second}' in row "
            f"{worst.rows[0]}): look at them with 'fungrasp grasps show', or drop them"
        )
    if shapes:
        worst = max(shapes, key=lambda contact: contact.depth)
        pairs = _some([f"'{contact.first}' and '{contact.second}'" for contact in shapes], "")
        words.append(
            f"links penetrate each other by their shapes, at the zero pose or in over {BY_SHAPE:.0%} of all "
            f"poses, by up to {1e3 * worst.depth:.1f} mm: {pairs}; {exclusion(worst.first, worst.second)}"
        )
    return words


def _some(values: Sequence[object], noun: str = "rows ") -> str:
    """Return the first values and the number of further ones."""
    more = f" and {len(values) - NAMED} more" if len(values) > NAMED else ""
    return noun + ", ".join(map(str, values[:NAMED])) + more


def exclusion(first: str, second: str) -> str:
    """Return the remedy for shapes of two bodies that penetrate each other."""
    return (
        f'shrink them, or if the links don\'t touch in truth, write <contact><exclude body1="{first}" '
        f'body2="{second}"/></contact> into the model'
    )
