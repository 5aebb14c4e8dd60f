"""Which loops stand for which term."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from fungrasp.optimization import terms
from fungrasp.optimization.compiled.closure_term import add_force_closure
from fungrasp.optimization.compiled.collision_terms import (
    add_gaps,
    add_object_penetration,
    add_self_penetration,
    add_table_penetration,
)
from fungrasp.optimization.compiled.frames import Equations, Frames
from fungrasp.optimization.compiled.hand_arrays import HandArrays
from fungrasp.optimization.compiled.pose_terms import add_directions, add_displacements, add_positions
from fungrasp.optimization.contact_forces import BALANCE_ITERATIONS
from fungrasp.optimization.hand_state import HandPoints

Add = Callable[[HandArrays, Frames, Equations, np.ndarray, np.ndarray], None]
"""Adds a term to normal equations, given the hand, where it is, wrist poses and independent joints."""


def compiled_term(term: Callable[..., Any], points: HandPoints, problem: Any) -> Add | None:
    """The loops of a term of ``fungrasp.optimization.terms``; None for any other.

    Args:
        term: one of those functions, or a ``functools.partial`` of one with keywords.
        points: of the hand.
        problem: N grasps, object frame.
    """
    keywords: dict[str, Any] = {}
    while isinstance(term, partial):
        if term.args:
            return None
        keywords = {**term.keywords, **keywords}
        term = term.func
    maker = _MAKERS.get(term)
    return None if maker is None else maker(points, problem, **keywords)


def _plain(array: np.ndarray, kind: type) -> np.ndarray:
    """A writable, contiguous copy: loops are compiled anew for every other kind of array."""
    return np.array(array, dtype=kind, order="C")


def _fingertip_position(points: HandPoints, problem: Any, unit: float = 0.01) -> Add:
    match = points.match
    far, target = match.far[match.is_last], _plain(problem.joints[:, match.human_far[match.is_last]], float)
    weight = np.full(target.shape[:2], 1.0 / unit)
    return lambda hand, frames, equations, *_: add_positions(hand, frames, equations, far, target, weight)


def _keypoint_position(
    points: HandPoints, problem: Any, which: np.ndarray, target: np.ndarray, weight: np.ndarray
) -> Add:
    target, weight = _plain(target, float), _plain(weight, float)
    return lambda hand, frames, equations, *_: add_positions(hand, frames, equations, which, target, weight)


def _link_direction(
    points: HandPoints, problem: Any, unit: float = 0.5, links: np.ndarray | slice = slice(None)
) -> Add:
    match = points.match
    near, far = match.near[links], match.far[links]
    human = problem.joints[:, match.human_far[links]] - problem.joints[:, match.human_near[links]]
    target = _plain(human / np.linalg.norm(human, axis=-1, keepdims=True), float)
    return lambda hand, frames, equations, *_: add_directions(
        hand, frames, equations, near, far, target, unit
    )


def _contact_position(
    points: HandPoints, problem: Any, unit: float = 0.005, inner_weight: float = 0.4
) -> Add:
    target, weight = (_plain(x, float) for x in terms.contact_targets(points, problem, unit, inner_weight))
    far = points.match.far
    return lambda hand, frames, equations, *_: add_positions(hand, frames, equations, far, target, weight)


def _contact_gap(points: HandPoints, problem: Any, unit: float = 0.003) -> Add:
    grids, grid, wanted = problem.bank.arrays, _plain(problem.grid, np.int64), _plain(problem.contacts, bool)
    return lambda hand, frames, equations, *_: add_gaps(hand, frames, equations, grids, grid, wanted, unit)


def _object_penetration(
    points: HandPoints, problem: Any, unit: float = 0.001, margin: float = 0.0, count: int = 24
) -> Add:
    grids, grid = problem.bank.arrays, _plain(problem.grid, np.int64)
    return lambda hand, frames, equations, *_: add_object_penetration(
        hand, frames, equations, grids, grid, unit, margin, count
    )


def _table_penetration(
    points: HandPoints, problem: Any, unit: float = 0.001, margin: float = 0.001, count: int = 12
) -> Add:
    up, height = _plain(problem.up, float), _plain(problem.height, float)
    return lambda hand, frames, equations, *_: add_table_penetration(
        hand, frames, equations, up, height, unit, margin, count
    )


def _self_penetration(
    points: HandPoints, problem: Any, unit: float = 0.002, margin: float = 0.001, count: int = 8
) -> Add:
    return lambda hand, frames, equations, *_: add_self_penetration(
        hand, frames, equations, unit, margin, count
    )


def _force_closure(
    points: HandPoints, problem: Any, unit: float = 0.05, friction: float = 0.3, reach: float = 0.006
) -> Add:
    far, wanted = points.match.far, _plain(problem.contacts[:, 1:], bool)
    grids, grid = problem.bank.arrays, _plain(problem.grid, np.int64)
    center, extent = _plain(problem.center, float), _plain(problem.extent, float)
    return lambda hand, frames, equations, *_: add_force_closure(
        hand, frames, equations, grids, grid, far, wanted, center, extent, unit, friction, reach,
        BALANCE_ITERATIONS,
    )  # fmt: skip


def _stay_near(
    points: HandPoints,
    problem: Any,
    start: tuple[np.ndarray, np.ndarray],
    unit: float = 1.0,
    position_unit: float = np.inf,
    rotation_unit: float = np.inf,
) -> Add:
    start = _plain(start[0], float), _plain(start[1], float)
    units = np.repeat([position_unit, rotation_unit, unit], [3, 3, start[1].shape[1]]).astype(float)
    return lambda hand, frames, equations, pose, independent: add_displacements(
        equations, pose, independent, *start, units
    )


_MAKERS: Mapping[Callable[..., Any], Callable[..., Add]] = {
    terms.fingertip_position: _fingertip_position,
    terms.keypoint_position: _keypoint_position,
    terms.link_direction: _link_direction,
    terms.contact_position: _contact_position,
    terms.contact_gap: _contact_gap,
    terms.object_penetration: _object_penetration,
    terms.table_penetration: _table_penetration,
    terms.self_penetration: _self_penetration,
    terms.force_closure: _force_closure,
    terms.stay_near: _stay_near,
}
