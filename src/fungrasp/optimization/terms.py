"""The terms of the retargeting objective (paper IV.A).

The objective is half the sum of squares of all residuals. A term is a function of the hand's points and N
grasps to solve; it returns a function that adds the term to their normal equations. ``functools.partial``
sets its other arguments. Residuals are divided by the length or angle that counts as one unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.geometry.distance_queries import unit_vector
from fungrasp.hands.kinematics import BodyPoints
from fungrasp.optimization.collision_terms import object_penetration, self_penetration, table_penetration
from fungrasp.optimization.force_closure import force_closure
from fungrasp.optimization.frames import (
    AddTerm,
    Equations,
    Frames,
    add_point,
    empty_row,
    finish_row,
    place,
)
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.link_contacts import contact_gap, contact_position
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem

__all__ = [
    "Residual",
    "ResidualTerm",
    "Term",
    "contact_gap",
    "contact_position",
    "fingertip_position",
    "force_closure",
    "keypoint_position",
    "link_direction",
    "object_penetration",
    "residual_terms",
    "self_penetration",
    "stay_near",
    "table_penetration",
]

Term = Callable[[HandPoints, Any], AddTerm]
"""A term of the objective."""

Residual = tuple[np.ndarray, np.ndarray]
"""Residuals, shape [N, R], and their Jacobian, shape [N, R, D]."""

ResidualTerm = Callable[[HandState[Any]], Residual]
"""A term written with NumPy."""


def residual_terms(terms: Sequence[ResidualTerm]) -> Term:
    """Combine terms written with NumPy, which are simpler to write than compiled ones but slower."""

    def bind(points: HandPoints, problem: CollisionScene) -> AddTerm:
        def add(frames: Frames, equations: Equations, pose: np.ndarray, independent: np.ndarray) -> None:
            state = HandState(points, problem, pose, independent)
            for term in terms:
                residual, jacobian = term(state)
                transposed = np.swapaxes(jacobian, 1, 2)
                equations.cost[:] += 0.5 * np.sum(residual**2, axis=1)
                equations.hessian[:] += transposed @ jacobian
                equations.gradient[:] += (transposed @ residual[..., None])[..., 0]

        return add

    return bind


def fingertip_position(points: HandPoints, problem: RetargetingProblem, unit: float = 0.01) -> AddTerm:
    """Penalize (p_tip - p_human tip) / unit of each finger: the first initialization of IV.A. unit: [m]."""
    match = points.match
    target = problem.joints[:, match.human_far[match.is_last]]
    weight = np.full(target.shape[:2], 1.0 / unit)
    return keypoint_position(points, problem, match.far[match.is_last], target, weight)


def keypoint_position(
    points: HandPoints, problem: CollisionScene, which: np.ndarray, target: np.ndarray, weight: np.ndarray
) -> AddTerm:
    """Penalize weight (p - target) of key points p.

    Args:
        which: indices of key points, shape [Q].
        target: [m], shape [N, Q, 3].
        weight: [1/m], shape [N, Q].
    """
    at, target, weight = points.arrays.keypoints[which], plain(target), plain(weight)
    return lambda frames, equations, *_: _add_positions(frames, equations, at, target, weight)


@compiled
def _add_positions(
    frames: Frames, equations: Equations, at: BodyPoints, target: np.ndarray, weight: np.ndarray
) -> None:
    """Add ``keypoint_position``; at: the key points."""
    body, offset = at.bodies, at.offsets
    row = empty_row(equations.gradient.shape[1])
    for i in range(len(target)):
        if not equations.active[i]:
            continue
        for q in range(len(body)):
            w = weight[i, q]
            if w == 0:
                continue
            point = place(frames, i, body[q], offset[q])
            for k in range(3):
                push = (w * (k == 0), w * (k == 1), w * (k == 2))
                add_point(row, frames, i, body[q], point, push)
                finish_row(row, equations, i, w * (point[k] - target[i, q, k]))


def link_direction(
    points: HandPoints,
    problem: RetargetingProblem,
    unit: float = 0.5,
    links: np.ndarray | slice = slice(None),
) -> AddTerm:
    """Penalize (d_robot - d_human) / unit of finger links, d the unit vector from the near to the far key
    point (IV.A).

    Args:
        unit: dimensionless.
        links: indices of finger links; all S by default.
    """
    match, at = points.match, points.arrays.keypoints
    near, far = at[match.near[links]], at[match.far[links]]
    human = problem.joints[:, match.human_far[links]] - problem.joints[:, match.human_near[links]]
    target = plain(human / np.linalg.norm(human, axis=-1, keepdims=True))
    return lambda frames, equations, *_: _add_directions(frames, equations, near, far, target, unit)


@compiled
def _add_directions(
    frames: Frames, equations: Equations, near: BodyPoints, far: BodyPoints, target: np.ndarray, unit: float
) -> None:
    """Add ``link_direction``; near, far: the key points. target: unit vectors, shape [N, Q, 3]."""
    near_body, near_offset, far_body, far_offset = near.bodies, near.offsets, far.bodies, far.offsets
    row = empty_row(equations.gradient.shape[1])
    for i in range(len(target)):
        if not equations.active[i]:
            continue
        for q in range(len(near_body)):
            a = place(frames, i, near_body[q], near_offset[q])
            b = place(frames, i, far_body[q], far_offset[q])
            x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            length = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            # The derivative of a normalized vector is (I - d d^T) / length. Two rows along tangents of the
            # unit sphere therefore replace three rows along the axes; the residual along d is constant.
            if abs(x) < 0.9:
                ux, uy, uz = unit_vector(0.0, z, -y)
            else:
                ux, uy, uz = unit_vector(-z, 0.0, x)
            vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
            ex, ey, ez = (
                (x - target[i, q, 0]) / unit,
                (y - target[i, q, 1]) / unit,
                (z - target[i, q, 2]) / unit,
            )
            along = x * ex + y * ey + z * ez
            equations.cost[i] += 0.5 * along * along
            scale = 1.0 / (length * unit)
            push, pull = (ux * scale, uy * scale, uz * scale), (-ux * scale, -uy * scale, -uz * scale)
            add_point(row, frames, i, far_body[q], b, push)
            add_point(row, frames, i, near_body[q], a, pull)
            finish_row(row, equations, i, ux * ex + uy * ey + uz * ez)
            push, pull = (vx * scale, vy * scale, vz * scale), (-vx * scale, -vy * scale, -vz * scale)
            add_point(row, frames, i, far_body[q], b, push)
            add_point(row, frames, i, near_body[q], a, pull)
            finish_row(row, equations, i, vx * ex + vy * ey + vz * ez)


def stay_near(
    points: HandPoints,
    problem: CollisionScene,
    start: tuple[np.ndarray, np.ndarray],
    unit: float = 1.0,
    position_unit: float = np.inf,
    rotation_unit: float = np.inf,
) -> AddTerm:
    """Penalize differences of joints, wrist position and wrist rotation from ``start``, divided by their
    units.

    Args:
        start: wrist poses [N, 7] and independent joints [rad], shape [N, U].
        unit, position_unit, rotation_unit: [rad], [m], [rad].
    """
    start = plain(start[0]), plain(start[1])
    units = np.repeat([position_unit, rotation_unit, unit], [3, 3, start[1].shape[1]]).astype(float)
    return lambda frames, equations, pose, independent: _add_displacements(
        equations, pose, independent, *start, units
    )


@compiled
def _add_displacements(
    equations: Equations,
    pose: np.ndarray,
    independent: np.ndarray,
    start_pose: np.ndarray,
    start_independent: np.ndarray,
    units: np.ndarray,
) -> None:
    """Add ``stay_near``. units: shape [D]."""
    for i in range(len(pose)):
        if not equations.active[i]:
            continue
        for k in range(len(units)):
            if k < 3:
                value = pose[i, k] - start_pose[i, k]
            elif k < 6:
                value = _turn(pose, start_pose, i, k - 3)
            else:
                value = independent[i, k - 6] - start_independent[i, k - 6]
            scaled = value / units[k]
            equations.cost[i] += 0.5 * scaled * scaled
            equations.gradient[i, k] += scaled / units[k]
            equations.hessian[i, k, k] += 1.0 / (units[k] * units[k])


@compiled_part
def _turn(pose, start_pose, i: int, k: int) -> float:
    """Return component k of the rotation vector from the start's rotation to the pose's [rad]."""
    q, start = pose[i, 3:], start_pose[i, 3:]
    w = q[0] * start[0] + q[1] * start[1] + q[2] * start[2] + q[3] * start[3]
    x = -q[0] * start[1] + q[1] * start[0] - q[2] * start[3] + q[3] * start[2]
    y = -q[0] * start[2] + q[1] * start[3] + q[2] * start[0] - q[3] * start[1]
    z = -q[0] * start[3] - q[1] * start[2] + q[2] * start[1] + q[3] * start[0]
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return factor * (x if k == 0 else y if k == 1 else z)
