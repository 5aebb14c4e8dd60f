"""A hand's points as flat arrays for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.poses import rotation_matrix
from fungrasp.hands.kinematics import HandKinematics

if TYPE_CHECKING:
    from fungrasp.optimization.hand_state import HandPoints

GROUP_SIZE = 8
"""Most spheres in a group that is passed over together where it is far from everything."""


class Tree(NamedTuple):
    """Bodies and hinge joints; B bodies, M joints, U independent joints.

    The joints that move a body are entries ``chain_start[body]`` to ``chain_start[body + 1]`` of the arrays
    ``chain_...``, an entry for each independent joint that drives a joint.
    """

    parent: np.ndarray
    """Parent of each body, shape [B]."""
    position: np.ndarray
    """Of each body in its parent [m], shape [B, 3]."""
    rotation: np.ndarray
    """Of each body in its parent, shape [B, 3, 3]."""
    first_joint: np.ndarray
    """Of each body, shape [B + 1]: its joints are ``first_joint[b]`` to ``first_joint[b + 1]``."""
    anchor: np.ndarray
    """Of each joint in its body [m], shape [M, 3]."""
    axis: np.ndarray
    """Of each joint in its body, shape [M, 3]."""
    zero: np.ndarray
    """Joint position in which the model was written [rad], shape [M]."""
    coupling: np.ndarray
    """``joint_positions = coupling @ independent + offset``, shape [M, U]."""
    offset: np.ndarray
    """[rad], shape [M]."""
    palm_position: np.ndarray
    """Of the palm in the model [m], shape [3]."""
    palm_rotation: np.ndarray
    """Of the palm in the model, shape [3, 3]."""
    lower: np.ndarray
    """Lower limits of the independent joints [rad], shape [U]."""
    upper: np.ndarray
    """Upper limits of the independent joints [rad], shape [U]."""
    chain_start: np.ndarray
    """First entry of each body, shape [B + 1]."""
    chain_joint: np.ndarray
    """Joint of each entry."""
    chain_column: np.ndarray
    """Column of each entry's independent joint in a tangent vector, from 6 on."""
    chain_factor: np.ndarray
    """How far the joint moves for a unit of the independent one."""


class Points(NamedTuple):
    """Key points, or centers of spheres, that ride on bodies."""

    body: np.ndarray
    """Body ids, shape [P]."""
    offset: np.ndarray
    """Position in the body [m], shape [P, 3]."""


class Groups(NamedTuple):
    """Collision spheres in groups of neighbors on one body; G groups, ordered by link."""

    start: np.ndarray
    """Group g holds ``members[start[g] : start[g + 1]]``, shape [G + 1]."""
    members: np.ndarray
    """Sphere indices, shape [P]."""
    body: np.ndarray
    """Shape [G]."""
    center: np.ndarray
    """In the body [m], shape [G, 3]."""
    reach: np.ndarray
    """Largest distance of a sphere's surface from the center [m], shape [G]."""
    link_start: np.ndarray
    """Groups of link l are ``link_start[l]`` to ``link_start[l + 1]``, shape [L + 1]."""


class Pairs(NamedTuple):
    """Pairs of groups whose spheres may meet."""

    first: np.ndarray
    """Group indices, shape [Q]."""
    second: np.ndarray
    """Group indices, shape [Q]."""


class HandArrays(NamedTuple):
    """What compiled terms know of a hand."""

    tree: Tree
    """Bodies and joints."""
    keypoints: Points
    """Key points."""
    spheres: Points
    """Centers of the collision spheres."""
    radius: np.ndarray
    """Of the spheres [m], shape [P]."""
    groups: Groups
    """Of the spheres."""
    pairs: Pairs
    """For collisions of the hand with itself."""


def hand_arrays(points: HandPoints) -> HandArrays:
    """Flatten a hand's points."""
    spheres = Points(*(np.ascontiguousarray(x) for x in points.spheres.points))
    groups = _groups(spheres, points.spheres.radius, points.spheres.link, points.spheres.geom)
    return HandArrays(
        tree=_tree(points.kinematics),
        keypoints=Points(*(np.ascontiguousarray(x) for x in points.keypoints)),
        spheres=spheres,
        radius=points.spheres.radius,
        groups=groups,
        pairs=_pairs(points, groups),
    )


def _tree(kinematics: HandKinematics) -> Tree:
    model, matrix = kinematics.model, kinematics.matrix
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = model.body(kinematics.hand.palm).id
    entries = [
        [(joint, 6 + u, matrix[joint, u]) for joint in joints for u in np.flatnonzero(matrix[joint])]
        for joints in (np.flatnonzero(row) for row in kinematics.moves)
    ]
    flat = [entry for body in entries for entry in body]
    return Tree(
        parent=model.body_parentid.astype(np.int64),
        position=model.body_pos.copy(),
        rotation=rotation_matrix(model.body_quat),
        first_joint=np.cumsum([0, *model.body_jntnum]),
        anchor=model.jnt_pos.copy(),
        axis=model.jnt_axis.copy(),
        zero=model.qpos0[model.jnt_qposadr].copy(),
        coupling=matrix,
        offset=kinematics.offset,
        palm_position=data.xpos[palm].copy(),
        palm_rotation=data.xmat[palm].reshape(3, 3).copy(),
        lower=kinematics.lower,
        upper=kinematics.upper,
        chain_start=np.cumsum([0, *(len(body) for body in entries)]),
        chain_joint=np.array([joint for joint, _, _ in flat], dtype=np.int64),
        chain_column=np.array([column for _, column, _ in flat], dtype=np.int64),
        chain_factor=np.array([factor for _, _, factor in flat], dtype=float),
    )


def _groups(spheres: Points, radius: np.ndarray, link: np.ndarray, geom: np.ndarray) -> Groups:
    parts: list[np.ndarray] = []
    count = [0] * (link.max() + 1)
    for number in range(len(count)):
        for each in np.unique(geom[link == number]):
            found = list(_split(np.flatnonzero((geom == each) & (link == number)), spheres.offset))
            parts += found
            count[number] += len(found)
    low = [(spheres.offset[p].min(axis=0), spheres.offset[p].max(axis=0)) for p in parts]
    center = np.array([0.5 * (a + b) for a, b in low]).reshape(-1, 3)
    reach = [
        np.max(np.linalg.norm(spheres.offset[p] - c, axis=1) + radius[p])
        for p, c in zip(parts, center, strict=True)
    ]
    return Groups(
        start=np.cumsum([0, *(len(p) for p in parts)]),
        members=np.concatenate(parts),
        body=np.array([spheres.body[p[0]] for p in parts]),
        center=center,
        reach=np.array(reach),
        link_start=np.cumsum([0, *count]),
    )


def _split(members: np.ndarray, offset: np.ndarray) -> Sequence[np.ndarray]:
    """Halves along the longest extent until they are small."""
    if len(members) <= GROUP_SIZE:
        return [members]
    places = offset[members]
    order = members[np.argsort(places[:, np.ptp(places, axis=0).argmax()], kind="stable")]
    half = len(order) // 2
    return [*_split(order[:half], offset), *_split(order[half:], offset)]


def _pairs(points: HandPoints, groups: Groups) -> Pairs:
    # The spheres of a group are of one shape of one link, so that all or none of them count.
    given = points.self_pairs
    apart = np.zeros((len(groups.reach), len(groups.reach)), dtype=bool)
    group = np.empty(len(groups.members), dtype=int)
    group[groups.members] = np.repeat(np.arange(len(groups.reach)), np.diff(groups.start))
    apart[np.ix_(group[given.first], group[given.second])] = given.apart
    return Pairs(*np.nonzero(apart))
