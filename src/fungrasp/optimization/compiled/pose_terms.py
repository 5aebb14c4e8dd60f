"""Terms that compare poses and key points: the loops of ``fungrasp.optimization.terms``."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.optimization.compiled.compiling import compiled
from fungrasp.optimization.compiled.distances import unit_vector
from fungrasp.optimization.compiled.frames import (
    Equations,
    Frames,
    add_point,
    empty_row,
    finish_row,
    place,
)
from fungrasp.optimization.compiled.hand_arrays import HandArrays


@compiled
def add_positions(
    hand: HandArrays,
    frames: Frames,
    equations: Equations,
    which: np.ndarray,
    target: np.ndarray,
    weight: np.ndarray,
) -> None:
    """weight (p - target) for some key points.

    Args:
        which: key points, shape [Q].
        target: [m], shape [N, Q, 3].
        weight: [1/m], shape [N, Q]; nothing is added where it is zero.
    """
    row = empty_row(equations.gradient.shape[1])
    for i in range(len(target)):
        if not equations.active[i]:
            continue
        for q in range(len(which)):
            w = weight[i, q]
            if w == 0:
                continue
            body = hand.keypoints.body[which[q]]
            point = place(frames, i, body, hand.keypoints.offset[which[q]])
            add_point(row, hand.tree, frames, i, body, point, (w, 0.0, 0.0))
            finish_row(row, equations, i, w * (point[0] - target[i, q, 0]))
            add_point(row, hand.tree, frames, i, body, point, (0.0, w, 0.0))
            finish_row(row, equations, i, w * (point[1] - target[i, q, 1]))
            add_point(row, hand.tree, frames, i, body, point, (0.0, 0.0, w))
            finish_row(row, equations, i, w * (point[2] - target[i, q, 2]))


@compiled
def add_directions(
    hand: HandArrays,
    frames: Frames,
    equations: Equations,
    near: np.ndarray,
    far: np.ndarray,
    target: np.ndarray,
    unit: float,
) -> None:
    """(d - target) / unit, d the unit vector from the near to the far key point of a link.

    Args:
        near, far: key points, shape [Q].
        target: unit vectors, shape [N, Q, 3].
        unit: dimensionless.
    """
    row = empty_row(equations.gradient.shape[1])
    for i in range(len(target)):
        if not equations.active[i]:
            continue
        for q in range(len(near)):
            near_body, far_body = hand.keypoints.body[near[q]], hand.keypoints.body[far[q]]
            a = place(frames, i, near_body, hand.keypoints.offset[near[q]])
            b = place(frames, i, far_body, hand.keypoints.offset[far[q]])
            x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            length = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            # The derivative of a normalized vector is (I - d d^T) / length: two rows, along tangents of the
            # sphere, say what three along the axes do. The rest of the residual, along d, does not move.
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
            add_point(row, hand.tree, frames, i, far_body, b, push)
            add_point(row, hand.tree, frames, i, near_body, a, pull)
            finish_row(row, equations, i, ux * ex + uy * ey + uz * ez)
            push, pull = (vx * scale, vy * scale, vz * scale), (-vx * scale, -vy * scale, -vz * scale)
            add_point(row, hand.tree, frames, i, far_body, b, push)
            add_point(row, hand.tree, frames, i, near_body, a, pull)
            finish_row(row, equations, i, vx * ex + vy * ey + vz * ez)


@compiled
def add_displacements(
    equations: Equations,
    pose: np.ndarray,
    independent: np.ndarray,
    start_pose: np.ndarray,
    start_independent: np.ndarray,
    units: np.ndarray,
) -> None:
    """Displacements from ``start`` over their units, as ``stay_near``. units: shape [D]."""
    size = len(units)
    for i in range(len(pose)):
        if not equations.active[i]:
            continue
        for k in range(size):
            if k < 3:
                value = pose[i, k] - start_pose[i, k]
            elif k < 6:
                value = _turn(pose[i, 3:], start_pose[i, 3:], k - 3)
            else:
                value = independent[i, k - 6] - start_independent[i, k - 6]
            scaled = value / units[k]
            equations.cost[i] += 0.5 * scaled * scaled
            equations.gradient[i, k] += scaled / units[k]
            equations.hessian[i, k, k] += 1.0 / (units[k] * units[k])


@compiled
def _turn(q, start, k: int) -> float:
    """Component k of the rotation vector of ``q`` after the inverse of ``start`` [rad]."""
    w = q[0] * start[0] + q[1] * start[1] + q[2] * start[2] + q[3] * start[3]
    x = -q[0] * start[1] + q[1] * start[0] - q[2] * start[3] + q[3] * start[2]
    y = -q[0] * start[2] + q[1] * start[3] + q[2] * start[0] - q[3] * start[1]
    z = -q[0] * start[3] - q[1] * start[2] + q[2] * start[1] + q[3] * start[0]
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return factor * (x if k == 0 else y if k == 1 else z)
