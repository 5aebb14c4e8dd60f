"""Where the views of an object are to each other: turned about the table's normal and shifted along the table.

The table gives each view its height and tilt, so that three numbers are left: iterative closest points from several
turns find them, with the colours, as round things have no shape that tells how they are turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

COLOR_LENGTH = 0.02
"""A difference of colour from black to white counts as much as this distance [m]."""

POINTS = 1200
"""Points of each view that are registered."""

ITERATIONS = 25
"""Steps of closest points from each start."""

OVERLAP = 0.7
"""Part of a view's points that the views before it see as well."""


@dataclass(frozen=True)
class Registered:
    """How a view is turned and shifted."""

    yaw: float
    """Turn about the table's normal [rad]."""
    shift: np.ndarray
    """Shift after it [m], shape [3]; the third is 0."""
    residual: float
    """Root mean square distance of the nearer part of its points from those of the other views [m]."""


def register(
    points: np.ndarray,
    colors: np.ndarray,
    known: np.ndarray,
    known_colors: np.ndarray,
    turns: Sequence[float] | np.ndarray,
    rng: np.random.Generator,
) -> Registered:
    """Turn and shift a view onto the points of others.

    Args:
        points: of the view [m], table frame, shape [P, 3].
        colors: from 0 to 1, shape [P, 3].
        known: points of the views before it [m], shape [K, 3].
        known_colors: shape [K, 3].
        turns: from which to start [rad].
        rng: chooses points.
    """
    chosen = rng.permutation(len(points))[:POINTS]
    place, color = points[chosen], colors[chosen] * COLOR_LENGTH
    there = rng.permutation(len(known))[: 4 * POINTS]
    target = np.concatenate([known[there], known_colors[there] * COLOR_LENGTH], axis=1)
    tree = KDTree(target)
    best: Registered | None = None
    least = np.inf
    for turn in turns:
        found, cost = _closest(place, color, tree, target, float(turn))
        if cost < least:
            best, least = found, cost
    assert best is not None
    return best


def _closest(
    place: np.ndarray, color: np.ndarray, tree: KDTree, target: np.ndarray, yaw: float
) -> tuple[Registered, float]:
    """Closest points from a turn; also the cost with which starts are compared."""
    middle = np.append(_middle(place), 0.0)
    shift = np.append(_middle(target) - _turn(yaw, middle[None])[0][:2], 0.0)
    distance = np.zeros(len(place))
    kept = np.zeros(0, dtype=int)
    for _ in range(ITERATIONS):
        moved = _turn(yaw, place) + shift
        distance, nearest = tree.query(np.concatenate([moved, color], axis=1))
        kept = np.argsort(distance)[: int(OVERLAP * len(place))]
        a, b = moved[kept][:, :2], target[nearest[kept]][:, :2]
        # The best turn and shift in the plane (Procrustes): atan2 of the sums of cross and dot products.
        ca, cb = a.mean(axis=0), b.mean(axis=0)
        a, b = a - ca, b - cb
        step = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
        shift = np.append(_turn(step, np.append(shift[:2] - ca, 0.0)[None])[0][:2] + cb, 0.0)
        yaw += step
        if abs(step) < 1e-5:
            break
    moved = _turn(yaw, place) + shift
    distance, nearest = tree.query(np.concatenate([moved, color], axis=1))
    apart = np.linalg.norm(moved - target[nearest, :3], axis=1)
    residual = float(np.sqrt(np.mean(np.sort(apart)[: int(OVERLAP * len(apart))] ** 2)))
    cost = float(np.mean(np.sort(distance)[: int(OVERLAP * len(distance))] ** 2))
    return Registered(yaw, shift, residual), cost


def _middle(points: np.ndarray) -> np.ndarray:
    """Middle of the points' extent along the table, shape [2]."""
    low, high = np.percentile(points[:, :2], (2, 98), axis=0)
    return 0.5 * (low + high)


def _turn(yaw: float, points: np.ndarray) -> np.ndarray:
    """Points turned about z. Both: shape [P, 3]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
