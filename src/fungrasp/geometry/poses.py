"""Batched rigid transforms on any array-API library (NumPy, torch, ...).

A pose is 7 numbers ``[x y z qw qx qy qz]``: metres and a unit quaternion. Arrays have any leading batch
shape and broadcast. ``pose_a_b`` maps points of frame b to frame a: ``pose_a_c = compose(pose_a_b,
pose_b_c)``.

For a single pose it is the number of calls that takes time, so quaternions work as matrices there.
"""

from __future__ import annotations

from typing import Any

import array_api_compat
import numpy as np

Array = Any
"""An array of NumPy, torch or another array-API library."""
TINY = 1e-30
"""Added to divisors that may be zero; it leaves the last digit of those that are not."""


_HAMILTON = np.array(
    [
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]],
        [[0, 0, 1, 0], [0, 0, 0, -1], [-1, 0, 0, 0], [0, 1, 0, 0]],
        [[0, 0, 0, 1], [0, 0, 1, 0], [0, -1, 0, 0], [-1, 0, 0, 0]],
    ],
    dtype=float,
)
"""Products of the units 1, i, j, k with one another: that of the first by row, the second by column."""
_RIGHT_FACTOR = np.reshape(np.moveaxis(_HAMILTON, 0, -1), (4, 16))
"""Makes of a quaternion ``b`` the matrix M, row by row, with ``a b = M a``."""
_SKEW = np.reshape(np.swapaxes(np.cross(np.eye(3)[:, None], np.eye(3)), 1, 2), (3, 9))
"""Makes of a vector ``a`` the matrix M, row by row, with ``a x b = M b``."""
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def _turn_factors() -> np.ndarray:
    """Makes of a unit quaternion's products wx, wy, wz, xx, ... zz its matrix less the identity, by row."""
    scalar, axis = np.zeros((3, 3, 3)), np.zeros((3, 3, 3, 3))
    for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        axis[y, y, x, x] = axis[z, z, x, x] = -2.0
        axis[x, y, x, y] = axis[x, y, y, x] = 2.0
        scalar[z, y, x], scalar[z, x, y] = 2.0, -2.0
    return np.concatenate([np.reshape(scalar, (3, 9)), np.reshape(axis, (9, 9))])


_TURN_FACTORS = _turn_factors()
_IDENTITY = np.eye(3)


def array_namespace(*arrays: Array) -> Any:
    """The library that computes with these arrays, by the names of the array API."""
    # NumPy has them itself, and to ask what a library is takes longer than a product of two quaternions.
    for array in arrays:
        if type(array) is not np.ndarray:
            return array_api_compat.array_namespace(*arrays)
    return np


def like(array: Array, values: np.ndarray) -> Array:
    """Constant values as an array of the library, number type and device of another."""
    if type(array) is np.ndarray and array.dtype == values.dtype:
        return values
    return array_namespace(array).asarray(values, dtype=array.dtype, device=array.device)


def stack(*arrays: Array) -> Array:
    """Arrays of one shape along a new first axis; the libraries' own takes two or three times as long."""
    return array_namespace(*arrays).concat([array[None] for array in arrays])


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Hamilton product ``a b``. a, b: wxyz, shape [..., 4]."""
    xp = array_namespace(a, b)
    factor = xp.reshape(xp.matmul(b, like(b, _RIGHT_FACTOR)), (*b.shape, 4))
    return xp.vecdot(factor, a[..., None, :])


def quaternion_conjugate(q: Array) -> Array:
    """Inverse of a unit quaternion. q: wxyz, shape [..., 4]."""
    return q * like(q, _CONJUGATE)


def cross(a: Array, b: Array) -> Array:
    """Cross product with broadcasting (the array API's own does not broadcast). Shape [..., 3]."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return _side_by_side(array_namespace(a, b), ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def norm(v: Array) -> Array:
    """Length of vectors. v: shape [..., N]; returns shape [..., 1]."""
    xp = array_namespace(v)
    return xp.sqrt(xp.vecdot(v, v))[..., None]


def rotate(q: Array, v: Array) -> Array:
    """Rotate vectors. q: wxyz, shape [..., 4]; v: shape [..., 3]; they broadcast."""
    axis = q[..., 1:]
    t = 2.0 * cross(axis, v)
    return v + q[..., :1] * t + cross(axis, t)


def quaternion_from_rotation_vector(v: Array) -> Array:
    """Exponential map. v: axis times angle [rad], shape [..., 3]. Returns wxyz, shape [..., 4]."""
    xp = array_namespace(v)
    half = 0.5 * norm(v) + TINY
    return xp.concat([xp.cos(half), 0.5 * xp.sin(half) / half * v], axis=-1)


def rotation_vector(q: Array) -> Array:
    """Logarithm, the shorter way round. q: wxyz, shape [..., 4]. Returns [rad], shape [..., 3], norm <=
    pi."""
    xp = array_namespace(q)
    cosine, axis = q[..., :1], q[..., 1:]
    sine = norm(axis)
    half = xp.atan2(sine, xp.abs(cosine))
    return axis * xp.copysign(2.0 * half / (sine + TINY), cosine)


def rotation_matrix(q: Array) -> Array:
    """q: wxyz, shape [..., 4]. Returns shape [..., 3, 3]."""
    xp = array_namespace(q)
    products = xp.reshape(q[..., None] * q[..., None, 1:], (*q.shape[:-1], 12))
    change = xp.reshape(xp.matmul(products, like(q, _TURN_FACTORS)), (*q.shape[:-1], 3, 3))
    return change + like(q, _IDENTITY)


def euler_angles(q: Array) -> Array:
    """Turns about x, the new y, the newest z, one after the other [rad]; the second is at most a right angle,
    and where it is one only the sum or the difference of the others counts.

    In halves: ``w + y = (cos b + sin b) cos(a + c)``, ``x + z = (cos b + sin b) sin(a + c)``, and with ``-``
    for all ``+`` likewise. q: wxyz, shape [..., 4]; returns shape [..., 3].
    """
    xp = array_namespace(q)
    wx, yz = q[..., :2], q[..., 2:]
    parts = stack(wx + yz, wx - yz)
    both, apart = xp.atan2(parts[..., 1], parts[..., 0])
    most, least = norm(parts)[..., 0]
    angles = _side_by_side(xp, both + apart, 2.0 * xp.atan2(most, least) - 0.5 * xp.pi, both - apart)
    return angles - 2.0 * xp.pi * xp.floor(angles / (2.0 * xp.pi) + 0.5)


def compose(pose_a_b: Array, pose_b_c: Array) -> Array:
    """``pose_a_c``. Poses: shape [..., 7]; they broadcast."""
    xp = array_namespace(pose_a_b, pose_b_c)
    position = pose_a_b[..., :3] + _rotate_one(pose_a_b[..., 3:], pose_b_c[..., :3])
    rotation = quaternion_multiply(pose_a_b[..., 3:], pose_b_c[..., 3:])
    return xp.concat([position, rotation], axis=-1)


def invert(pose_a_b: Array) -> Array:
    """``pose_b_a``. Shape [..., 7]."""
    xp = array_namespace(pose_a_b)
    inverse = quaternion_conjugate(pose_a_b[..., 3:])
    return xp.concat([-_rotate_one(inverse, pose_a_b[..., :3]), inverse], axis=-1)


def relative(pose_a_b: Array, pose_a_c: Array) -> Array:
    """``pose_b_c``: where c is, seen from b. Poses: shape [..., 7]; they broadcast."""
    xp = array_namespace(pose_a_b, pose_a_c)
    inverse = quaternion_conjugate(pose_a_b[..., 3:])
    position = _rotate_one(inverse, pose_a_c[..., :3] - pose_a_b[..., :3])
    return xp.concat([position, quaternion_multiply(inverse, pose_a_c[..., 3:])], axis=-1)


def transform_points(pose_a_b: Array, points_b: Array) -> Array:
    """Points of frame b in frame a. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return pose_a_b[..., None, :3] + rotate(pose_a_b[..., None, 3:], points_b)


def inverse_transform_points(pose_a_b: Array, points_a: Array) -> Array:
    """Points of frame a in frame b. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return rotate(quaternion_conjugate(pose_a_b[..., None, 3:]), points_a - pose_a_b[..., None, :3])


def _rotate_one(q: Array, v: Array) -> Array:
    """As ``rotate``, with half the calls, for one vector with each quaternion."""
    xp = array_namespace(q, v)
    skew = xp.reshape(xp.matmul(q[..., 1:], like(q, _SKEW)), (*q.shape[:-1], 3, 3))
    t = 2.0 * xp.vecdot(skew, v[..., None, :])
    return v + q[..., :1] * t + xp.vecdot(skew, t[..., None, :])


def _side_by_side(xp: Any, *parts: Array) -> Array:
    """Arrays of one shape as the numbers along a new last axis; ``stack`` takes twice the time."""
    first = parts[0]
    result = xp.empty((*first.shape, len(parts)), dtype=first.dtype, device=first.device)
    for number, part in enumerate(parts):
        result[..., number] = part
    return result
