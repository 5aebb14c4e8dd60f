"""Solver data of a hand, also as arrays for compiled loops, and the state of N hands at one iterate: key
points, collision spheres, distances, Jacobians."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Generic, NamedTuple, Self, TypeVar

import mujoco
import numpy as np

from fungrasp.geometry.compiling import plain
from fungrasp.geometry.poses import rotation_matrix
from fungrasp.hands import Hand
from fungrasp.hands.collisions import CollisionSpheres, collision_spheres
from fungrasp.hands.correspondence import correspond
from fungrasp.hands.kinematics import BodyPoints, HandKinematics
from fungrasp.optimization.problem import CollisionScene

DENSE_SPACING = 0.006
"""Spacing of the collision spheres that evaluate solutions [m]."""
GROUP_SIZE = 8
"""Maximum number of spheres in a group. A group far from all obstacles is skipped as a whole."""


class HandPoints:
    """Points of a hand that the terms use: key points, collision spheres and their correspondence with human
    links."""

    def __init__(self, kinematics: HandKinematics, spacing: float = 0.018):
        hand = kinematics.hand
        self.kinematics = kinematics
        self.match = correspond(hand)
        self.keypoints: BodyPoints = kinematics.body_points(hand.keypoint_names)
        self.spheres: CollisionSpheres = collision_spheres(hand, spacing)
        self.far_radius = self._thickness()
        self.link_members = [np.flatnonzero(self.spheres.link == link) for link in range(len(hand.links))]
        self.self_pairs = _self_pairs(hand, self.spheres)

    def for_hands(self, count: int) -> Self:
        """Return the same points for ``count`` hands, for use in another thread. Constant data is shared,
        including ``dense`` if it has been created."""
        other = copy(self)
        other.__dict__["arrays"] = self.arrays
        other.kinematics = HandKinematics(self.kinematics.hand, count)
        if "dense" in self.__dict__:
            other.__dict__["dense"] = dense = copy(self.dense)
            dense.kinematics = other.kinematics
        return other

    @cached_property
    def dense(self) -> HandPoints:
        """The same hand with denser spheres, to evaluate solutions: penetration between the solver's spheres
        must not go unnoticed."""
        dense = HandPoints(self.kinematics, DENSE_SPACING)
        _ = dense.arrays
        return dense

    @cached_property
    def arrays(self) -> HandArrays:
        """The hand as arrays for compiled loops."""
        return _hand_arrays(self)

    def _thickness(self) -> np.ndarray:
        """Return the radius of the sphere nearest to the far key point of each finger link [m], shape [S];
        the median radius if the key point is on another body."""
        radii = []
        for link, (near, far) in enumerate(zip(self.match.near, self.match.far, strict=True), start=1):
            members = np.flatnonzero(self.spheres.link == link)
            same = self.keypoints.bodies[far] == self.keypoints.bodies[near]
            if not len(members):
                radii.append(0.0)
            elif same:
                gaps = np.linalg.norm(
                    self.spheres.points.offsets[members] - self.keypoints.offsets[far], axis=1
                )
                radii.append(self.spheres.radius[members[np.argmin(gaps)]])
            else:
                radii.append(float(np.median(self.spheres.radius[members])))
        return np.array(radii)


def _self_pairs(hand: Hand, spheres: CollisionSpheres) -> SelfPairs:
    """Return pairs of spheres with a radius on links of different fingers."""
    finger = np.array([-1, *(i for i, f in enumerate(hand.fingers.values()) for _ in f.links)])
    round_spheres = np.flatnonzero((spheres.radius > 0) & (finger[spheres.link] >= 0))
    owner = finger[spheres.link[round_spheres]]
    return SelfPairs(round_spheres, round_spheres, owner[:, None] < owner)


ProblemT = TypeVar("ProblemT", bound=CollisionScene)


class HandState(Generic[ProblemT]):
    """N hands at one iterate of the solver, object frame: positions, distances, and Jacobians on demand.

    Jacobians are with respect to the D = 6 + U tangent coordinates of ``HandKinematics``: wrist translation
    [m], wrist rotation [rad], independent joints [rad].
    """

    def __init__(
        self, points: HandPoints, problem: ProblemT, wrist_pose: np.ndarray, independent: np.ndarray
    ):
        self.points, self.problem = points, problem
        self.wrist_pose, self.independent = wrist_pose, independent
        points.kinematics.update(wrist_pose, independent)
        self.keypoints = points.kinematics.points(points.keypoints)
        """Key points [m], shape [N, K, 3]."""
        self.spheres = points.kinematics.points(points.spheres.points)
        """Centers of the collision spheres [m], shape [N, P, 3]."""
        distance, gradient = problem.bank.query(problem.grid, self.spheres)
        self.clearance = distance - points.spheres.radius
        """Distance of each sphere's surface from the object [m], shape [N, P]; negative for penetration."""
        self.normals = gradient
        """Gradient of the distance at the centers, shape [N, P, 3]: about a unit vector out of the object."""
        # [N, P, 3] . [N, T, 3] + [N, 1, T]: height of each center above each of the T planes.
        heights = np.einsum("npi,nti->npt", self.spheres, problem.up) + problem.height[:, None]
        self.heights = heights.min(axis=2) - points.spheres.radius
        """Distance of each sphere's surface from the nearest plane [m], shape [N, P]."""

    def sphere_jacobian(self, which: np.ndarray) -> np.ndarray:
        """Return the Jacobian of sphere centers, shape [N, Q, 3, D]. which: sphere indices, shape [N, Q]."""
        positions = np.take_along_axis(self.spheres, which[..., None], axis=1)
        return self.points.kinematics.jacobian(self.points.spheres.points.bodies[which], positions)


class Tree(NamedTuple):
    """Bodies and joints of a hand's model; B bodies, M joints, U independent joints."""

    parent: np.ndarray
    """Parent of each body, shape [B]."""
    position: np.ndarray
    """Position of each body in its parent [m], shape [B, 3]."""
    rotation: np.ndarray
    """Rotation of each body in its parent, shape [B, 3, 3]."""
    first_joint: np.ndarray
    """The joints of body b are ``first_joint[b]`` to ``first_joint[b + 1]``, shape [B + 1]."""
    anchor: np.ndarray
    """Anchor of each joint in its body [m], shape [M, 3]."""
    axis: np.ndarray
    """Axis of each joint in its body, shape [M, 3]."""
    coupling: np.ndarray
    """``joint_positions - qpos0 = coupling @ independent + offset``, shape [M, U]."""
    offset: np.ndarray
    """[rad] or [m], shape [M]."""
    palm_position: np.ndarray
    """Position of the palm in the model [m], shape [3]."""
    palm_rotation: np.ndarray
    """Rotation of the palm in the model, shape [3, 3]."""


class Chains(NamedTuple):
    """Joints that move each body: entries ``start[body]`` to ``start[body + 1]``, one for each independent
    joint that drives a joint."""

    start: np.ndarray
    """First entry of each body, shape [B + 1]."""
    joint: np.ndarray
    """Joint of each entry."""
    column: np.ndarray
    """Column of each entry's independent joint in a tangent vector, from 6 on."""
    factor: np.ndarray
    """Derivative of the joint with respect to the independent joint."""
    slides: np.ndarray
    """Whether a joint is a slide joint, not a hinge, shape [M] bool."""


class Spheres(NamedTuple):
    """Collision spheres fixed to bodies."""

    body: np.ndarray
    """Body ids, shape [P]."""
    offset: np.ndarray
    """Centers in the body frame [m], shape [P, 3]."""
    radius: np.ndarray
    """Radii [m], shape [P]."""


class SelfPairs(NamedTuple):
    """Pairs of spheres of a hand that may collide, each once: all or none of the spheres of two shapes."""

    first: np.ndarray
    """Sphere indices, shape [A]."""
    second: np.ndarray
    """Sphere indices, shape [B]."""
    apart: np.ndarray
    """Whether a pair counts, shape [A, B]."""


class Groups(NamedTuple):
    """G groups of neighboring collision spheres on one body, ordered by link."""

    start: np.ndarray
    """Group g holds ``members[start[g] : start[g + 1]]``, shape [G + 1]."""
    members: np.ndarray
    """Sphere indices, shape [P]."""
    body: np.ndarray
    """Body ids, shape [G]."""
    center: np.ndarray
    """Centers in the body frame [m], shape [G, 3]."""
    reach: np.ndarray
    """Largest distance of a sphere's surface from the center [m], shape [G]."""
    link_start: np.ndarray
    """Groups of link l are ``link_start[l]`` to ``link_start[l + 1]``, shape [L + 1]."""


class HandArrays(NamedTuple):
    """A hand as arrays for compiled terms."""

    tree: Tree
    """Bodies and joints."""
    chains: Chains
    """Joints that move each body."""
    keypoints: BodyPoints
    """Key points."""
    spheres: Spheres
    """Collision spheres."""
    groups: Groups
    """Groups of the spheres."""
    pairs: np.ndarray
    """Pairs of groups whose spheres may collide, shape [Q, 2]."""


def _hand_arrays(points: HandPoints) -> HandArrays:
    kinematics, spheres, keypoints = points.kinematics, points.spheres, points.keypoints
    flat = Spheres(
        np.array(spheres.points.bodies, dtype=np.int64), plain(spheres.points.offsets), plain(spheres.radius)
    )
    groups = _groups(flat, spheres.link, spheres.geom)
    return HandArrays(
        tree=_tree(kinematics),
        chains=_chains(kinematics),
        keypoints=BodyPoints(plain(keypoints.bodies, np.int64), plain(keypoints.offsets)),
        spheres=flat,
        groups=groups,
        pairs=_pairs(points.self_pairs, groups),
    )


def _tree(kinematics: HandKinematics) -> Tree:
    model = kinematics.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palm = model.body(kinematics.hand.palm).id
    return Tree(
        parent=plain(model.body_parentid, np.int64),
        position=plain(model.body_pos),
        rotation=plain(rotation_matrix(model.body_quat)),
        first_joint=np.cumsum([0, *model.body_jntnum]),
        anchor=plain(model.jnt_pos),
        axis=plain(model.jnt_axis),
        coupling=plain(kinematics.matrix),
        offset=kinematics.offset - model.qpos0[model.jnt_qposadr],
        palm_position=plain(data.xpos[palm]),
        palm_rotation=plain(data.xmat[palm].reshape(3, 3)),
    )


def _chains(kinematics: HandKinematics) -> Chains:
    matrix = kinematics.matrix
    entries = [
        [(joint, 6 + u, matrix[joint, u]) for joint in joints for u in np.flatnonzero(matrix[joint])]
        for joints in (np.flatnonzero(row) for row in kinematics.moves)
    ]
    flat = [entry for body in entries for entry in body]
    return Chains(
        start=np.cumsum([0, *(len(body) for body in entries)]),
        joint=np.array([joint for joint, _, _ in flat], dtype=np.int64),
        column=np.array([column for _, column, _ in flat], dtype=np.int64),
        factor=np.array([factor for _, _, factor in flat], dtype=float),
        slides=kinematics.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE,
    )


def _groups(spheres: Spheres, link: np.ndarray, geom: np.ndarray) -> Groups:
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
        np.max(np.linalg.norm(spheres.offset[p] - c, axis=1) + spheres.radius[p])
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
    """Halve along the longest extent until the parts are small."""
    if len(members) <= GROUP_SIZE:
        return [members]
    places = offset[members]
    order = members[np.argsort(places[:, np.ptp(places, axis=0).argmax()], kind="stable")]
    half = len(order) // 2
    return [*_split(order[:half], offset), *_split(order[half:], offset)]


def _pairs(given: SelfPairs, groups: Groups) -> np.ndarray:
    # The spheres of a group belong to one shape of one link, so that all or none of them count.
    apart = np.zeros((len(groups.reach), len(groups.reach)), dtype=bool)
    group = np.empty(len(groups.members), dtype=int)
    group[groups.members] = np.repeat(np.arange(len(groups.reach)), np.diff(groups.start))
    apart[np.ix_(group[given.first], group[given.second])] = given.apart
    return np.argwhere(apart)
