"""Objective terms for a human hand that holds named parts of an object.

As in ``fungrasp.optimization.terms``: residuals, shape [N, R], and their Jacobian, shape [N, R, D].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import trimesh
from scipy.spatial import KDTree

from fungrasp.core.errors import UnknownNameError
from fungrasp.grasps import HUMAN_LINKS
from fungrasp.hands.kinematics import BodyPoints, HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandPoints, HandState, SelfPairs
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.terms import Residual
from fungrasp.synthesis.grasp_specification import GRASP_KINDS, WHOLE, GraspSpecification

PAD = 0.4
"""Offset of a finger pad's center from the axis of its capsule, as a fraction of the capsule's radius. The
pad is a sphere that touches the capsule from inside."""

SAMPLE_GAP = 0.003
"""Largest edge of the triangles whose corners and centers sample a part's surface [m]."""

SAMPLE_CELL = 0.001
"""Edge of cubes that contain at most one sample each [m]."""


class HumanPoints(HandPoints):
    """``HandPoints`` of the human hand with finger pads, sides towards the thumb, and self-collision pairs
    that include the palm."""

    def __init__(self, kinematics: HandKinematics, spacing: float = 0.018):
        super().__init__(kinematics, spacing)
        points, radius = self.spheres.points, self.spheres.radius
        shift = PAD * radius[:, None]
        self.pads = BodyPoints(points.bodies, points.offsets + shift * np.array([1.0, 0.0, 0.0]))
        self.sides = BodyPoints(points.bodies, points.offsets + shift * np.array([0.0, 1.0, 0.0]))
        self.self_pairs = _pairs(self)


def _pairs(points: HumanPoints) -> SelfPairs:
    """Pair spheres of different fingers, and of fingers and palm except for links attached to the palm."""
    # finger: -1 for the palm, 0 to 3 for index to pinky, 4 for the thumb; place: 0 to 2 from base to tip.
    link = points.spheres.link
    finger, place = np.where(link > 0, (link - 1) // 3, -1), np.where(link > 0, (link - 1) % 3, -1)
    every = np.arange(len(link))
    apart = (finger[:, None] < finger) & ~((finger[:, None] == -1) & (place == 0))
    thumb = (finger == 4) & (place == 1)
    apart &= ~((finger[:, None] == -1) & thumb)
    return SelfPairs(every, every, apart)


@dataclass(frozen=True)
class PartTargets:
    """Parts that the links of N hands must touch."""

    trees: tuple[KDTree, ...]
    """Surface samples of the parts."""
    tree: np.ndarray
    """Index in ``trees`` of each link's part, -1 for none, shape [N, 16]."""
    radial: np.ndarray
    """Whether the link touches with its side towards the thumb, shape [N, 16] bool."""
    places: np.ndarray
    """Point for the link to touch [m], NaN for any point, object frame, shape [N, 16, 3]."""

    @classmethod
    def from_specifications(
        cls, specs: Sequence[GraspSpecification], objects: Mapping[str, ObjectModel]
    ) -> PartTargets:
        """Return the targets of N hands, one specification each.

        Raises:
            FungraspError: an object lacks a part.
        """
        keys = sorted({(spec.object, part) for spec in specs for part in spec.part_of_link.values()})
        tree = np.full((len(specs), len(HUMAN_LINKS)), -1)
        radial = np.zeros(tree.shape, dtype=bool)
        places = np.full((*tree.shape, 3), np.nan)
        for row, spec in enumerate(specs):
            for link, part in spec.part_of_link.items():
                tree[row, HUMAN_LINKS.index(link)] = keys.index((spec.object, part))
            for link in GRASP_KINDS[spec.kind].radial:
                radial[row, HUMAN_LINKS.index(link)] = True
            for link, place in spec.places.items():
                places[row, HUMAN_LINKS.index(link)] = place
        return cls(tuple(part_samples(objects[name], part) for name, part in keys), tree, radial, places)

    def nearest(self, which: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return nearest samples [m], shape [Q, 3]. which: tree indices, shape [Q]; points: [m], shape
        [Q, 3]."""
        result = np.empty_like(points)
        for index, tree in enumerate(self.trees):
            rows = which == index
            if rows.any():
                result[rows] = tree.data[tree.query(points[rows])[1]]
        return result


@lru_cache(maxsize=256)
def part_samples(model: ObjectModel, part: str) -> KDTree:
    """Return points about 2 mm apart on the faces of a part.

    Raises:
        UnknownNameError: the object has no such part.
    """
    if part != WHOLE and part not in model.parts:
        raise UnknownNameError(f"part of object '{model.name}'", part, (*model.parts, WHOLE))
    chosen = model.faces if part == WHOLE else model.faces[model.parts[part]]
    corners, faces = trimesh.remesh.subdivide_to_size(model.vertices, chosen, SAMPLE_GAP, max_iter=30)[:2]
    points = np.concatenate([corners[np.unique(faces)], corners[faces].mean(axis=1)])
    # Long thin triangles have hundreds of samples per millimeter, which only take time.
    first = np.unique(np.floor(points / SAMPLE_CELL).astype(np.int64), axis=0, return_index=True)[1]
    return KDTree(points[np.sort(first)])


def _touching_points(state: HandState[CollisionScene], targets: PartTargets) -> np.ndarray:
    """Return the touching points (pads or sides) of all spheres [m], shape [N, P, 3]."""
    points = state.points
    assert isinstance(points, HumanPoints)
    pads, sides = points.kinematics.points(points.pads), points.kinematics.points(points.sides)
    return np.where(targets.radial[:, points.spheres.link, None], sides, pads)


def part_gap(state: HandState[CollisionScene], targets: PartTargets, unit: float = 0.002) -> Residual:
    """Return max(0, |x - s| - r) / unit for each target link, with x and r its pad nearest to the part, and s
    the sample of the part nearest to the pad.

    Args:
        unit: [m].
    """
    pads = _touching_points(state, targets)
    link, radius = state.points.spheres.link, (1 - PAD) * state.points.spheres.radius
    # One query per sphere of each (hand, link) pair with a target; ``query`` is the pair of each sphere.
    rows, links = np.nonzero(targets.tree >= 0)
    order = np.argsort(link, kind="stable")
    first, count = np.searchsorted(link[order], links), np.bincount(link, minlength=16)[links]
    query = np.repeat(np.arange(len(rows)), count)
    sphere = order[
        np.repeat(first, count) + np.arange(len(query)) - np.repeat(np.cumsum(count) - count, count)
    ]
    position = pads[rows[query], sphere]
    between = position - targets.nearest(targets.tree[rows, links][query], position)
    distance = np.linalg.norm(between, axis=1)
    gap = distance - radius[sphere]
    starts = np.cumsum(count) - count
    # Sorted by pair, then gap: the first of each pair is its nearest sphere.
    best = np.lexsort((gap, np.repeat(np.arange(len(rows)), count)))[starts]
    gap, direction = gap[best], between[best] / np.maximum(distance[best], 1e-9)[:, None]
    move = _rows_jacobian(state, rows, sphere[best], position[best])
    residual = np.zeros((len(state.wrist_pose), len(HUMAN_LINKS)))
    jacobian = np.zeros((*residual.shape, state.points.kinematics.size))
    residual[rows, links] = np.maximum(gap, 0) / unit
    jacobian[rows, links] = np.einsum("qi,qid->qd", direction * (gap > 0)[:, None], move) / unit
    return residual, jacobian


def place_error(state: HandState[CollisionScene], targets: PartTargets, unit: float = 0.008) -> Residual:
    """Return (x - p) / unit for links with a place p, with x the link's pad nearest to it.

    Args:
        unit: [m].
    """
    pads = _touching_points(state, targets)
    rows, links = np.nonzero(np.isfinite(targets.places[..., 0]))
    residual = np.zeros((len(pads), 48))
    jacobian = np.zeros((len(pads), 48, state.points.kinematics.size))
    if not len(rows):
        return residual, jacobian
    away = np.linalg.norm(pads[rows] - targets.places[rows, links][:, None], axis=-1)
    away[state.points.spheres.link[None] != links[:, None]] = np.inf
    sphere = np.argmin(away, axis=1)
    move = _rows_jacobian(state, rows, sphere, pads[rows, sphere])
    for axis in range(3):
        column = 3 * links + axis
        residual[rows, column] = (pads[rows, sphere, axis] - targets.places[rows, links, axis]) / unit
        jacobian[rows, column] = move[:, axis] / unit
    return residual, jacobian


def natural_posture(
    state: HandState[CollisionScene],
    kinds: Sequence[str],
    along_unit: float = 1.2,
    off_unit: float = 0.25,
    neighbor_unit: float = 0.4,
) -> Residual:
    """Keep joints near each finger's line from open to closed, and neighboring fingers about equally closed.

    For finger f with direction d_f from open to closed, the residuals are: (d_f . (q - open) - half of the
    distance) / ``along_unit``; the rest of q - open over ``off_unit``; and differences of d_f . q between
    neighbors over ``neighbor_unit``.

    Args:
        kinds: grasp kind of each hand, length N.
        along_unit, off_unit, neighbor_unit: [rad].
    """
    names = list(dict.fromkeys(kinds))
    each = [_posture(name, along_unit, off_unit, neighbor_unit) for name in names]
    which = np.array([names.index(kind) for kind in kinds])
    matrix, goal = np.stack([m for m, _ in each])[which], np.stack([g for _, g in each])[which]
    residual = (matrix @ state.independent[..., None])[..., 0] - goal
    jacobian = np.zeros((*residual.shape, state.points.kinematics.size))
    jacobian[..., 6:] = matrix
    return residual, jacobian


def _posture(
    kind: str, along_unit: float, off_unit: float, neighbor_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix and goal of ``natural_posture`` for one kind of grasp."""
    fingers = [slice(4 * finger, 4 * finger + 4) for finger in range(4)] + [slice(16, 21)]
    start = np.array(GRASP_KINDS[kind].open)
    span = np.array(GRASP_KINDS[kind].closed) - GRASP_KINDS[kind].open
    rows, along = [], []
    for finger in fingers:
        direction = np.zeros(21)
        direction[finger] = span[finger] / max(float(np.linalg.norm(span[finger])), 1e-9)
        along.append(direction)
        rows.append(direction / along_unit)
        rows += list((np.eye(21)[finger] - np.outer(direction[finger], direction)) / off_unit)
    rows += [(a - b) / neighbor_unit for a, b in pairwise(along[:4])]
    matrix = np.array(rows)
    half = [np.linalg.norm(span[finger]) / 2 for finger in fingers]
    return matrix, matrix @ (start + sum(h * d for h, d in zip(half, along, strict=True)))


def _rows_jacobian(
    state: HandState[CollisionScene], rows: np.ndarray, sphere: np.ndarray, position: np.ndarray
) -> np.ndarray:
    """Return the Jacobians of Q points of hands, shape [Q, 3, D].

    Args:
        rows: hand of each point, ascending, shape [Q].
        sphere: index of the sphere whose body carries the point, shape [Q].
        position: [m], shape [Q, 3].
    """
    # The kinematics need the same number of points for each hand: distribute the points to slots per hand.
    slot = np.arange(len(rows)) - np.searchsorted(rows, rows)
    count, slots = len(state.wrist_pose), int(slot.max()) + 1
    bodies, positions = np.zeros((count, slots), dtype=int), np.zeros((count, slots, 3))
    bodies[rows, slot] = state.points.spheres.points.bodies[sphere]
    positions[rows, slot] = position
    return state.points.kinematics.jacobian(bodies, positions)[rows, slot]
