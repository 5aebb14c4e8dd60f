"""Where the links of hands touch their objects, or would."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.compiling import compiled, plain
from fungrasp.geometry.distance_queries import unit_vector
from fungrasp.geometry.signed_distance import GridArrays
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.collision_terms import nearest_sphere
from fungrasp.optimization.frames import Frames, empty_frames, joint_motion, move_hands, place
from fungrasp.optimization.hand_arrays import Groups, Spheres
from fungrasp.optimization.hand_state import HandPoints

CONTACT_DISTANCE = 0.003
"""A link of a retargeted or synthesized hand nearer to the object than this touches it [m]."""


class LinkContacts(NamedTuple):
    """Where the L links of N hands touch, or would, object frame."""

    place: np.ndarray
    """Point of each link's surface that is nearest to the object [m], shape [N, L, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [N, L, 3]."""
    clearance: np.ndarray
    """Distance from the object [m], shape [N, L]; infinite for a link without a shape, and beyond what was
    asked for."""
    jacobian: np.ndarray
    """Of the points with respect to the independent joints [m/rad], shape [N, L, 3, U]."""


def contacts_of_links(
    points: HandPoints,
    problem: CollisionScene,
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    within: float = math.inf,
    which: np.ndarray | None = None,
) -> LinkContacts:
    """The point of each link that is nearest to the object.

    Args:
        points: of the hand.
        problem: N objects.
        wrist_pose: object frame, shape [N, 7].
        independent: joints [rad], shape [N, U].
        within: links farther from the object than this are left out [m].
        which: hands to look at, shape [N] bool; all if None.
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
    grid = plain(problem.grid, np.int64)
    _find(frames, hand.spheres, hand.groups, problem.bank.arrays, grid, active, float(within), found)
    return found


@compiled
def _find(
    frames: Frames,
    spheres: Spheres,
    groups: Groups,
    grids: GridArrays,
    grid: np.ndarray,
    active: np.ndarray,
    within: float,
    found: LinkContacts,
) -> None:
    """Write ``contacts_of_links``."""
    chains = frames.chains
    for i in range(len(grid)):
        if not active[i]:
            continue
        for link in range(len(groups.link_start) - 1):
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
