"""Batched rigid transforms on any array-API library (NumPy, torch, ...).

A pose is 7 numbers ``[x y z qw qx qy qz]``: metres and a unit quaternion. Arrays have any leading batch
shape and broadcast. ``pose_a_b`` maps points of frame b to frame a: ``pose_a_c = compose(pose_a_b,
pose_b_c)``.
"""

from __future__ import annotations

from typing import Any

import array_api_compat
import numpy as np

Array = Any
"""An array of NumPy, torch or another array-API library."""


def array_namespace(*arrays: Array) -> Any:
    """The library that computes with these arrays, by the names of the array API."""
    # NumPy has them itself, and to ask what a library is takes longer than a product of two quaternions.
    for array in arrays:
        if type(array) is not np.ndarray:
            return array_api_compat.array_namespace(*arrays)
    return np


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Hamilton product ``a b``. a, b: wxyz, shape [..., 4]."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return _side_by_side(
        array_namespace(a, b),
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def quaternion_conjugate(q: Array) -> Array:
    """Inverse of a unit quaternion. q: wxyz, shape [..., 4]."""
    xp = array_namespace(q)
    return xp.concat([q[..., :1], -q[..., 1:]], axis=-1)


def cross(a: Array, b: Array) -> Array:
    """Cross product with broadcasting (the array API's own does not broadcast). Shape [..., 3]."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return _side_by_side(array_namespace(a, b), ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def norm(v: Array) -> Array:
    """Length of vectors. v: shape [..., N]; returns shape [..., 1]."""
    xp = array_namespace(v)
    return xp.sqrt(xp.sum(v * v, axis=-1, keepdims=True))


def rotate(q: Array, v: Array) -> Array:
    """Rotate vectors. q: wxyz, shape [..., 4]; v: shape [..., 3]; they broadcast."""
    axis = q[..., 1:]
    t = 2.0 * cross(axis, v)
    return v + q[..., :1] * t + cross(axis, t)


def quaternion_from_rotation_vector(v: Array) -> Array:
    """Exponential map. v: axis times angle [rad], shape [..., 3]. Returns wxyz, shape [..., 4]."""
    xp = array_namespace(v)
    half = 0.5 * norm(v)
    small = half < 1e-8
    safe = xp.where(small, 1.0, half)
    scale = xp.where(small, 0.5 - half**2 / 12.0, 0.5 * xp.sin(safe) / safe)
    return xp.concat([xp.cos(half), scale * v], axis=-1)


def rotation_vector(q: Array) -> Array:
    """Logarithm, the shorter way round. q: wxyz, shape [..., 4]. Returns [rad], shape [..., 3], norm <=
    pi."""
    xp = array_namespace(q)
    q = xp.where(q[..., :1] < 0, -q, q)
    sine = norm(q[..., 1:])
    small = sine < 1e-10
    angle = 2.0 * xp.atan2(sine, q[..., :1])
    return q[..., 1:] * xp.where(small, 2.0, angle / xp.where(small, 1.0, sine))


def rotation_matrix(q: Array) -> Array:
    """q: wxyz, shape [..., 4]. Returns shape [..., 3, 3]."""
    xp = array_namespace(q)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        _side_by_side(xp, 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        _side_by_side(xp, 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        _side_by_side(xp, 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return xp.stack(rows, axis=-2)


def compose(pose_a_b: Array, pose_b_c: Array) -> Array:
    """``pose_a_c``. Poses: shape [..., 7]; they broadcast."""
    xp = array_namespace(pose_a_b, pose_b_c)
    position = pose_a_b[..., :3] + rotate(pose_a_b[..., 3:], pose_b_c[..., :3])
    rotation = quaternion_multiply(pose_a_b[..., 3:], pose_b_c[..., 3:])
    return xp.concat([position, rotation], axis=-1)


def invert(pose_a_b: Array) -> Array:
    """``pose_b_a``. Shape [..., 7]."""
    xp = array_namespace(pose_a_b)
    inverse = quaternion_conjugate(pose_a_b[..., 3:])
    return xp.concat([-rotate(inverse, pose_a_b[..., :3]), inverse], axis=-1)


def transform_points(pose_a_b: Array, points_b: Array) -> Array:
    """Points of frame b in frame a. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return pose_a_b[..., None, :3] + rotate(pose_a_b[..., None, 3:], points_b)


def inverse_transform_points(pose_a_b: Array, points_a: Array) -> Array:
    """Points of frame a in frame b. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return rotate(quaternion_conjugate(pose_a_b[..., None, 3:]), points_a - pose_a_b[..., None, :3])


def _side_by_side(xp: Any, *parts: Array) -> Array:
    """Arrays of one shape as the numbers along a new last axis; ``stack`` takes twice the time."""
    first = parts[0]
    result = xp.empty((*first.shape, len(parts)), dtype=first.dtype, device=first.device)
    for number, part in enumerate(parts):
        result[..., number] = part
    return result
