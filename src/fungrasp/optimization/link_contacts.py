"""Contact points of hand links, and terms that close contact gaps and move contacts to the human ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.array_distances import GridArrays
from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.geometry.distance_queries import distance_bound, signed_distance, unit_vector
from fungrasp.geometry.poses import compose, invert
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.frames import (
    AddTerm,
    Equations,
    Frames,
    add_point,
    empty_frames,
    empty_row,
    finish_row,
    joint_motion,
    move_hands,
    place,
)
from fungrasp.optimization.hand_state import Groups, HandPoints, Spheres
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem

CONTACT_DISTANCE = 0.003
"""A link of a retargeted or synthesized hand touches the object if it is nearer than this [m]."""


class Shapes(NamedTuple):
    """Collision spheres of a hand and the objects of N copies of it."""

    spheres: Spheres
    """Collision spheres of the hand."""
    groups: Groups
    """Groups of the spheres."""
    grids: GridArrays
    """Signed-distance grids of the objects."""
    grid: np.ndarray
    """Index of each hand's object, shape [N]."""


def shapes_of(points: HandPoints, problem: CollisionScene) -> Shapes:
    """Return the shapes of hands and objects for compiled loops."""
    arrays = points.arrays
    return Shapes(arrays.spheres, arrays.groups, problem.bank.arrays, plain(problem.grid, np.int64))


class LinkContacts(NamedTuple):
    """Nearest points of the L links of N hands to their objects, object frame."""

    place: np.ndarray
    """Point of each link's surface nearest to the object [m], shape [N, L, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [N, L, 3]."""
    clearance: np.ndarray
    """Distance from the object [m], shape [N, L]; infinite for a link without collision spheres or beyond
    ``within``."""
    jacobian: np.ndarray
    """Jacobian of the points with respect to the independent joints [m/rad], shape [N, L, 3, U]."""


def contacts_of_links(
    points: HandPoints,
    problem: CollisionScene,
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    within: float = math.inf,
    which: np.ndarray | None = None,
) -> LinkContacts:
    """Return the point of each link nearest to the object.

    Args:
        problem: collision geometry of N hands.
        wrist_pose: object frame, shape [N, 7].
        independent: joints [rad], shape [N, U].
        within: maximum distance of links from the object [m].
        which: hands to evaluate, shape [N] bool; all if None.
    """
    hand, count = points.arrays, len(problem)
    links, joints = len(hand.groups.link_start) - 1, hand.tree.coupling.shape[1]
    found = LinkContacts(
        np.zeros((count, links, 3)),
        np.zeros((count, links, 3)),
        np.full((count, links), np.inf),
        np.zeros((count, links, 3, joints)),
    )
    active = np.ones(count, dtype=bool) if which is None else plain(which, bool)
    frames = empty_frames(count, hand)
    move_hands(hand.tree, plain(wrist_pose), plain(independent), active, frames)
    _find(frames, shapes_of(points, problem), active, float(within), found)
    return found


@compiled
def _find(frames: Frames, shapes: Shapes, active: np.ndarray, within: float, found: LinkContacts) -> None:
    """Write ``contacts_of_links``."""
    spheres, groups, grids, grid = shapes
    chains = frames.chains
    for i in range(len(active)):
        if not active[i]:
            continue
        for link in range(found.clearance.shape[1]):
            nearest, clearance, nx, ny, nz = nearest_sphere(
                frames, i, spheres, groups, link, grids, grid[i], within
            )
            if nearest < 0:
                continue
            body, r = spheres.body[nearest], spheres.radius[nearest]
            normal = unit_vector(nx, ny, nz)
            x, y, z = place(frames, i, body, spheres.offset[nearest])
            point = (x - r * normal[0], y - r * normal[1], z - r * normal[2])
            found.clearance[i, link] = clearance
            for k in range(3):
                found.place[i, link, k], found.inward[i, link, k] = point[k], -normal[k]
            for entry in range(chains.start[body], chains.start[body + 1]):
                unknown = chains.column[entry] - 6
                move = joint_motion(frames, i, chains.joint[entry], point)
                for k in range(3):
                    found.jacobian[i, link, k, unknown] += chains.factor[entry] * move[k]


def contact_gap(points: HandPoints, problem: RetargetingProblem, unit: float = 0.003) -> AddTerm:
    """Penalize max(0, gap_j) / unit of finger links that should touch, gap_j the clearance of link j. unit:
    [m]."""
    shapes, wanted = shapes_of(points, problem), plain(problem.contacts, bool)
    return lambda frames, equations, *_: _add_gaps(frames, equations, shapes, wanted, unit)


@compiled
def _add_gaps(frames: Frames, equations: Equations, shapes: Shapes, wanted: np.ndarray, unit: float) -> None:
    """Add ``contact_gap``. wanted: links that should touch, shape [N, L] bool."""
    spheres, groups, grids, grid = shapes
    row = empty_row(equations.gradient.shape[1])
    for i in range(len(wanted)):
        if not equations.active[i]:
            continue
        for link in range(1, wanted.shape[1]):
            if not wanted[i, link]:
                continue
            nearest, least, nx, ny, nz = nearest_sphere(
                frames, i, spheres, groups, link, grids, grid[i], math.inf
            )
            if nearest >= 0 and least > 0:
                body = spheres.body[nearest]
                point = place(frames, i, body, spheres.offset[nearest])
                add_point(row, frames, i, body, point, (nx / unit, ny / unit, nz / unit))
                finish_row(row, equations, i, least / unit)


def contact_position(points: HandPoints, problem: RetargetingProblem, unit: float = 0.005) -> AddTerm:
    """Penalize (x - (s_j + r n_j)) / unit of two spheres of each link j that should touch (L_pos of IV.A,
    applied to contact points).

    x and r are a sphere's center and radius. The two spheres are the one nearest to the object and the one
    nearest to its target s_j + r n_j; if they are the same, it counts once. s_j is the surface point nearest
    to the human joint at the far end of link j and n_j the outward normal there, so that thick robot fingers
    touch where thin human fingers did, from the same side. The sphere nearest to its target moves the link
    through a wall in between; the one nearest to the object keeps other parts of the link from touching
    elsewhere. unit: [m].
    """
    wanted = plain(problem.contacts[:, 1:], bool)
    target = plain(problem.surface), plain(problem.normals)
    shapes, scale = shapes_of(points, problem), 1.0 / unit
    return lambda frames, equations, *_: _add_positions(frames, equations, shapes, wanted, target, scale)


@compiled
def _add_positions(
    frames: Frames,
    equations: Equations,
    shapes: Shapes,
    wanted: np.ndarray,
    target: tuple[np.ndarray, np.ndarray],
    scale: float,
) -> None:
    """Add ``contact_position``. wanted: [N, S]; target: points [m] and normals, shape [N, S, 3] each."""
    (spheres, groups, grids, grid), (at, normal) = shapes, target
    row, pair = empty_row(equations.gradient.shape[1]), np.empty(2, np.int64)
    for i in range(len(wanted)):
        if not equations.active[i]:
            continue
        for s in range(wanted.shape[1]):
            if not wanted[i, s]:
                continue
            pair[0] = nearest_sphere(frames, i, spheres, groups, s + 1, grids, grid[i], math.inf)[0]
            pair[1] = _sphere_at(frames, i, spheres, groups, s + 1, at[i, s], normal[i, s])
            for m in range(2):
                ball = pair[m]
                if ball < 0 or (m == 1 and ball == pair[0]):
                    continue
                point, r = place(frames, i, spheres.body[ball], spheres.offset[ball]), spheres.radius[ball]
                for k in range(3):
                    push = (scale * (k == 0), scale * (k == 1), scale * (k == 2))
                    add_point(row, frames, i, spheres.body[ball], point, push)
                    finish_row(row, equations, i, scale * (point[k] - at[i, s, k] - r * normal[i, s, k]))


@compiled_part
def _sphere_at(frames: Frames, i: int, spheres: Spheres, groups: Groups, link: int, at, normal):
    """Return the sphere of a link nearest to touching the surface at a point [m] with this normal, or -1."""
    found, least = np.int64(-1), math.inf
    for k in range(groups.start[groups.link_start[link]], groups.start[groups.link_start[link + 1]]):
        ball = groups.members[k]
        point, r = place(frames, i, spheres.body[ball], spheres.offset[ball]), spheres.radius[ball]
        apart = 0.0
        for d in range(3):
            apart += (point[d] - at[d] - r * normal[d]) ** 2
        if apart < least:
            found, least = ball, apart
    return found


@compiled_part
def nearest_sphere(
    frames: Frames,
    i: int,
    spheres: Spheres,
    groups: Groups,
    link: int,
    grids: GridArrays,
    grid: int,
    within: float,
):
    """Return the sphere of a link nearest to the object. (No ``Shapes`` argument: unpacking nested records
    counts references, which takes time.)

    Returns:
        index, -1 if no sphere is nearer than ``within`` [m]; clearance [m]; gradient of the distance at the
        sphere's center.
    """
    nearest, least, nx, ny, nz = np.int64(-1), within, 0.0, 0.0, 0.0
    for group in range(groups.link_start[link], groups.link_start[link + 1]):
        if least_clearance(frames, i, groups, group, grids, grid) > least:
            continue
        for k in range(groups.start[group], groups.start[group + 1]):
            ball = groups.members[k]
            point = place(frames, i, spheres.body[ball], spheres.offset[ball])
            distance, gx, gy, gz = signed_distance(grids, grid, point)
            clearance = distance - spheres.radius[ball]
            if clearance < least:
                nearest, least, nx, ny, nz = ball, clearance, gx, gy, gz
    return nearest, least, nx, ny, nz


@compiled_part
def least_clearance(frames: Frames, i: int, groups: Groups, group: int, grids: GridArrays, grid: int):
    """Return a lower bound of the clearances [m] of a group's spheres."""
    point = place(frames, i, groups.body[group], groups.center[group])
    return distance_bound(grids, grid, point) - groups.reach[group]


@dataclass(frozen=True, eq=False)
class LinkTouch:
    """Points of a hand's links nearest to the object, object frame."""

    place: np.ndarray
    """Points [m], shape [L, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [L, 3]."""
    clearance: np.ndarray
    """Clearances [m], negative inside, shape [L]."""

    @property
    def reached(self) -> np.ndarray:
        """Links that touch, shape [L] bool."""
        return self.clearance < CONTACT_DISTANCE


class LinkDistances:
    """Distances of a hand's links from one object, computed in a millisecond."""

    def __init__(self, hand: Hand, model: ObjectModel):
        self._hand = hand
        self._points = HandPoints(HandKinematics(hand, 1), 0.006)
        self._scene = CollisionScene.settled(
            [model.name], np.array([[0, 0, 0, 1.0, 0, 0, 0]]), {model.name: model}
        )

    def of(self, wrist_pose: np.ndarray, joints: np.ndarray, object_pose: np.ndarray) -> LinkTouch:
        """Return the nearest points of a hand.

        Args:
            wrist_pose: pose of the palm body, world frame, shape [7].
            joints: all joints of the hand [rad], shape [M].
            object_pose: world frame, shape [7].
        """
        pose = compose(invert(object_pose), wrist_pose)[None]
        found = contacts_of_links(self._points, self._scene, pose, self._hand.independent(joints)[None])
        return LinkTouch(found.place[0], found.inward[0], found.clearance[0])
