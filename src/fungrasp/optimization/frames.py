"""Frames of a hand's bodies and joints, and Jacobian rows of points fixed to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part
from fungrasp.optimization.hand_state import Chains, HandArrays, Tree


class Frames(NamedTuple):
    """Body and joint frames of N hands, in the reference frame of the wrist poses."""

    position: np.ndarray
    """Body positions [m], shape [N, B, 3]."""
    rotation: np.ndarray
    """Body rotation matrices, shape [N, B, 3, 3]."""
    anchor: np.ndarray
    """Joint anchors [m], shape [N, M, 3]."""
    axis: np.ndarray
    """Joint axes, shape [N, M, 3]."""
    wrist: np.ndarray
    """Palm positions [m], shape [N, 3]."""
    chains: Chains
    """Joints that move each body."""


def empty_frames(count: int, hand: HandArrays) -> Frames:
    """Return uninitialized frames of ``count`` hands."""
    bodies, joints = len(hand.tree.parent), len(hand.tree.offset)
    return Frames(
        position=np.empty((count, bodies, 3)),
        rotation=np.empty((count, bodies, 3, 3)),
        anchor=np.empty((count, joints, 3)),
        axis=np.empty((count, joints, 3)),
        wrist=np.empty((count, 3)),
        chains=hand.chains,
    )


class Equations(NamedTuple):
    """Normal equations of N problems with D unknowns. Terms add to them."""

    cost: np.ndarray
    """Half the sum of squared residuals, shape [N]."""
    hessian: np.ndarray
    """J^T J, lower triangle, shape [N, D, D]."""
    gradient: np.ndarray
    """J^T r, shape [N, D]."""
    active: np.ndarray
    """Problems that are still being solved, shape [N] bool; others are skipped."""


AddTerm = Callable[[Frames, Equations, np.ndarray, np.ndarray], None]
"""Adds a term of the objective to normal equations. Arguments: frames, normal equations, wrist poses,
independent joints."""


class Row(NamedTuple):
    """One sparse row of a Jacobian. The first six columns, for the wrist, are always used."""

    values: np.ndarray
    """Entries, shape [D]."""
    columns: np.ndarray
    """Used columns in the first ``count`` entries, shape [D]."""
    used: np.ndarray
    """Whether each column is used, shape [D] bool."""
    count: np.ndarray
    """Number of used columns, shape [1]."""


@compiled_part
def empty_row(size: int) -> Row:
    """Return a row of zeros."""
    values, columns = np.empty(size), np.empty(size, np.int64)
    used, count = np.empty(size, np.bool_), np.empty(1, np.int64)
    for k in range(size):
        values[k], columns[k], used[k] = 0.0, k, k < 6
    count[0] = 6
    return Row(values, columns, used, count)


@compiled_part
def add_point(row: Row, frames: Frames, i: int, body: int, point, direction) -> None:
    """Add ``direction . d point / d tangent`` of a point [m] fixed to a body of hand ``i``."""
    x, y, z = point
    a, b, c = direction
    v, chains = row.values, frames.chains
    v[0] += a
    v[1] += b
    v[2] += c
    rx, ry, rz = x - frames.wrist[i, 0], y - frames.wrist[i, 1], z - frames.wrist[i, 2]
    v[3] += ry * c - rz * b
    v[4] += rz * a - rx * c
    v[5] += rx * b - ry * a
    for entry in range(chains.start[body], chains.start[body + 1]):
        joint, column = chains.joint[entry], chains.column[entry]
        ux, uy, uz = frames.axis[i, joint, 0], frames.axis[i, joint, 1], frames.axis[i, joint, 2]
        if chains.slides[joint]:
            move = ux * a + uy * b + uz * c
        else:
            rx = x - frames.anchor[i, joint, 0]
            ry = y - frames.anchor[i, joint, 1]
            rz = z - frames.anchor[i, joint, 2]
            # direction . (axis x lever) = axis . (lever x direction)
            move = ux * (ry * c - rz * b) + uy * (rz * a - rx * c) + uz * (rx * b - ry * a)
        v[column] += chains.factor[entry] * move
        if not row.used[column]:
            row.used[column] = True
            row.columns[row.count[0]] = column
            row.count[0] += 1


@compiled_part
def joint_motion(frames: Frames, i: int, joint: int, point):
    """Return the derivative of a point [m] of hand ``i`` with respect to a joint [m/rad] or [m/m], xyz."""
    a, b, c = frames.axis[i, joint, 0], frames.axis[i, joint, 1], frames.axis[i, joint, 2]
    if frames.chains.slides[joint]:
        return a, b, c
    rx = point[0] - frames.anchor[i, joint, 0]
    ry = point[1] - frames.anchor[i, joint, 1]
    rz = point[2] - frames.anchor[i, joint, 2]
    return b * rz - c * ry, c * rx - a * rz, a * ry - b * rx


@compiled_part
def finish_row(row: Row, equations: Equations, i: int, residual: float) -> None:
    """Add a residual and its row to the normal equations of problem ``i``, and clear the row."""
    v, columns, number = row.values, row.columns, row.count[0]
    hessian, gradient = equations.hessian[i], equations.gradient[i]
    equations.cost[i] += 0.5 * residual * residual
    for m in range(number):
        p = columns[m]
        gradient[p] += residual * v[p]
        for n in range(m + 1):
            q = columns[n]
            if p >= q:
                hessian[p, q] += v[p] * v[q]
            else:
                hessian[q, p] += v[p] * v[q]
    for m in range(number):
        v[columns[m]] = 0.0
    for m in range(6, number):
        row.used[columns[m]] = False
    row.count[0] = 6


@compiled_part
def place(frames: Frames, i: int, body: int, offset):
    """Return the position [m] of the point at ``offset`` in a body of hand ``i``, shape [3]."""
    p, r = frames.position[i, body], frames.rotation[i, body]
    x, y, z = offset[0], offset[1], offset[2]
    return (
        p[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * z,
        p[1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * z,
        p[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * z,
    )


@compiled
def move_hands(
    tree: Tree, pose: np.ndarray, independent: np.ndarray, active: np.ndarray, frames: Frames
) -> None:
    """Write the forward kinematics of the active hands to ``frames``, as MuJoCo computes them.

    Args:
        pose: wrist poses, shape [N, 7].
        independent: joint positions [rad], shape [N, U].
        active: shape [N] bool.
    """
    part = np.empty((3, 3))
    for i in range(len(pose)):
        if not active[i]:
            continue
        _place_model(tree, pose, i, frames.position[i, 0], frames.rotation[i, 0], part)
        for k in range(3):
            frames.wrist[i, k] = pose[i, k]
        for body in range(1, len(tree.parent)):
            parent = tree.parent[body]
            p, r = frames.position[i, body], frames.rotation[i, body]
            _carry(frames.position[i, parent], frames.rotation[i, parent], tree.position[body], p)
            _product(frames.rotation[i, parent], tree.rotation[body], r)
            for m in range(tree.first_joint[body], tree.first_joint[body + 1]):
                value = tree.offset[m]
                for u in range(independent.shape[1]):
                    value += tree.coupling[m, u] * independent[i, u]
                anchor, axis = frames.anchor[i, m], frames.axis[i, m]
                _carry(p, r, tree.anchor[m], anchor)
                for k in range(3):
                    axis[k] = (
                        r[k, 0] * tree.axis[m, 0] + r[k, 1] * tree.axis[m, 1] + r[k, 2] * tree.axis[m, 2]
                    )
                if frames.chains.slides[m]:
                    for k in range(3):
                        p[k] += value * axis[k]
                        anchor[k] += value * axis[k]
                    continue
                _turn(r, tree.axis[m], value, part)
                # The anchor stays where it is.
                for k in range(3):
                    p[k] = anchor[k] - (
                        r[k, 0] * tree.anchor[m, 0]
                        + r[k, 1] * tree.anchor[m, 1]
                        + r[k, 2] * tree.anchor[m, 2]
                    )


@compiled_part
def _place_model(tree: Tree, pose, i: int, position, rotation, part) -> None:
    """Write the frame of the model, given the palm pose."""
    w, x, y, z = pose[i, 3], pose[i, 4], pose[i, 5], pose[i, 6]
    part[0, 0], part[0, 1], part[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    part[1, 0], part[1, 1], part[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    part[2, 0], part[2, 1], part[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for k in range(3):
        for n in range(3):
            rotation[k, n] = 0.0
            for m in range(3):
                rotation[k, n] += part[k, m] * tree.palm_rotation[n, m]
    for k in range(3):
        position[k] = pose[i, k]
        for m in range(3):
            position[k] -= rotation[k, m] * tree.palm_position[m]


@compiled_part
def _carry(position, rotation, offset, result) -> None:
    for k in range(3):
        result[k] = (
            position[k] + rotation[k, 0] * offset[0] + rotation[k, 1] * offset[1] + rotation[k, 2] * offset[2]
        )


@compiled_part
def _product(a, b, result) -> None:
    for k in range(3):
        for n in range(3):
            result[k, n] = a[k, 0] * b[0, n] + a[k, 1] * b[1, n] + a[k, 2] * b[2, n]


@compiled_part
def _turn(rotation, axis, angle: float, part) -> None:
    """Multiply ``rotation`` by the rotation about an axis (Rodrigues), in place."""
    s, c = math.sin(angle), math.cos(angle)
    x, y, z = axis[0], axis[1], axis[2]
    t = 1 - c
    for k in range(3):
        a, b, d = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        part[k, 0] = a * (t * x * x + c) + b * (t * x * y + s * z) + d * (t * x * z - s * y)
        part[k, 1] = a * (t * x * y - s * z) + b * (t * y * y + c) + d * (t * y * z + s * x)
        part[k, 2] = a * (t * x * z + s * y) + b * (t * y * z - s * x) + d * (t * z * z + c)
    for k in range(3):
        for n in range(3):
            rotation[k, n] = part[k, n]
