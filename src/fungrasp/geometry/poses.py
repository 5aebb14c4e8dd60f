"""Batched rigid transforms on any array-API library (NumPy, torch, ...).

A pose is 7 numbers ``[x y z qw qx qy qz]``: meters and a unit quaternion. Arrays have any leading batch
shape and broadcast. ``pose_a_b`` maps points of frame b to frame a: ``pose_a_c = compose(pose_a_b,
pose_b_c)``.

For a single pose it is the number of calls that takes time, so quaternions work as matrices there.
"""

from __future__ import annotations

from contextlib import nullcontext
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
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
_PLACE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
"""Which numbers of a pose are its position."""


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


def _carry_factors() -> np.ndarray:
    """Makes of the same products and of w, x, y, z the matrix, row by row, that turns what of a pose is its
    position, less the identity, and what is its rotation."""
    result = np.zeros((16, 7, 7))
    result[:12, :3, :3] = np.reshape(_TURN_FACTORS, (12, 3, 3))
    result[12:, 3:, 3:] = np.swapaxes(_HAMILTON, 1, 2)
    return np.reshape(result, (16, 49))


_CARRY_FACTORS = _carry_factors()
_STAY = np.diag(_PLACE)
_CONSTANTS: dict[tuple[Any, ...], Array] = {}
"""What ``constant_on`` has made."""
_MOST_CONSTANTS = 1000
_FULL_TURN = 2.0 * np.pi
_EULER_HALVES = np.array([[1.0, 0, 1.0, 0], [0, 1.0, 0, 1.0], [1.0, 0, -1.0, 0], [0, 1.0, 0, -1.0]])
"""Makes of a quaternion ``w + y, x + z, w - y, x - z``."""


def array_namespace(array: Array, *others: Array) -> Any:
    """The library that computes with these arrays, all of one library, by the names of the array API."""
    # NumPy has them itself, and to ask what a library is takes longer than a product of two quaternions.
    if type(array) is np.ndarray:
        return np
    return array_api_compat.array_namespace(array, *others)


def like(array: Array, values: np.ndarray) -> Array:
    """Constant values as an array of the library, number type and device of another; not to be written to."""
    if type(array) is np.ndarray:
        return values if array.dtype == values.dtype else values.astype(array.dtype)
    return constant_on(array_namespace(array), array.device, array.dtype, values)


def constant_on(library: Any, device: Any, dtype: Any, values: np.ndarray) -> Array:
    """Constant values on a device, copied there once: the device would be waited for each time.

    Args:
        dtype: number type of the library's; that of the values if None.
    """
    key = library.__name__, str(device), str(dtype), values.dtype.str, values.shape, values.tobytes()
    if key not in _CONSTANTS:
        if len(_CONSTANTS) >= _MOST_CONSTANTS:
            _CONSTANTS.clear()
        # Torch's derivatives need tensors that were not made in its inference mode.
        mode = getattr(library, "inference_mode", None)
        with mode(False) if mode else nullcontext():
            _CONSTANTS[key] = library.asarray(values, dtype=dtype, device=device, copy=True)
    return _CONSTANTS[key]


def stack(*arrays: Array) -> Array:
    """Arrays of one shape along a new first axis; the libraries' own takes two or three times as long."""
    return array_namespace(*arrays).concat([array[None] for array in arrays])


def side_by_side(*parts: Array) -> Array:
    """Arrays of one shape as the numbers along a new last axis; NumPy's ``stack`` takes twice the time."""
    first = parts[0]
    if type(first) is not np.ndarray:
        return array_namespace(*parts).stack(parts, axis=-1)
    shape = (*first.shape, len(parts))
    result = np.empty(shape, dtype=first.dtype)
    for number, part in enumerate(parts):
        result[..., number] = part
    return result


def clip(array: Array, low: Any, high: Any) -> Array:
    """Numbers cut to limits, which are numbers or arrays; NumPy's own takes three times as long."""
    if type(array) is np.ndarray:
        return np.minimum(np.maximum(array, low), high)
    return array_namespace(array).clip(array, low, high)


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Hamilton product ``a b``. a, b: wxyz, shape [..., 4]."""
    xp = array_namespace(a, b)
    factor = xp.matmul(b, like(b, _RIGHT_FACTOR)).reshape((*b.shape, 4))
    return xp.vecdot(factor, a[..., None, :])


def quaternion_conjugate(q: Array) -> Array:
    """Inverse of a unit quaternion. q: wxyz, shape [..., 4]."""
    return q * like(q, _CONJUGATE)


def cross(a: Array, b: Array) -> Array:
    """Cross product with broadcasting (the array API's own does not broadcast). Shape [..., 3]."""
    if type(a) is not np.ndarray:
        xp = array_namespace(a, b)
        return xp.linalg.cross(*xp.broadcast_arrays(a, b))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return side_by_side(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


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
    angle = norm(v) + TINY
    half = 0.5 * angle
    return xp.concat([xp.cos(half), xp.sin(half) / angle * v], axis=-1)


def rotation_vector(q: Array) -> Array:
    """Logarithm, the shorter way round. q: wxyz, shape [..., 4]. Returns [rad], shape [..., 3], norm <=
    pi."""
    xp = array_namespace(q)
    cosine, axis = q[..., :1], q[..., 1:]
    sine = norm(axis)
    half = xp.atan2(sine, xp.abs(cosine))
    return axis * xp.copysign(2.0 * half / (sine + TINY), cosine)


def turned_towards(q: Array, goal: Array, angle: Array) -> Array:
    """Orientations on the shorter way from one to another.

    Args:
        q: where it begins, wxyz, shape [..., 4].
        goal: where it ends, likewise.
        angle: how far on the way, at most to its end [rad], shape [..., 1]; they broadcast.
    """
    xp = array_namespace(q, goal)
    way = quaternion_multiply(goal, quaternion_conjugate(q))
    cosine, axis = way[..., :1], way[..., 1:]
    sine = norm(axis)
    half = xp.minimum(0.5 * angle, xp.atan2(sine, xp.abs(cosine)))
    unit = axis * xp.copysign(1.0 / (sine + TINY), cosine)
    result = quaternion_multiply(xp.concat([xp.cos(half), xp.sin(half) * unit], axis=-1), q)
    return result / norm(result)


def rotation_matrix(q: Array) -> Array:
    """q: wxyz, shape [..., 4]. Returns shape [..., 3, 3]."""
    change = array_namespace(q).matmul(_products(q), like(q, _TURN_FACTORS))
    return change.reshape((*q.shape[:-1], 3, 3)) + like(q, _IDENTITY)


def euler_angles(q: Array) -> Array:
    """Turns about x, the new y, the newest z, one after the other [rad]; the second is at most a right angle,
    and where it is one only the sum or the difference of the others counts.

    In halves: ``w + y = (cos b + sin b) cos(a + c)``, ``x + z = (cos b + sin b) sin(a + c)``, and with ``-``
    for all ``+`` likewise. q: wxyz, shape [..., 4]; returns shape [..., 3].
    """
    xp = array_namespace(q)
    halves = xp.matmul(q, like(q, _EULER_HALVES)).reshape((*q.shape[:-1], 2, 2))
    cosines, sines = halves[..., 0], halves[..., 1]
    turns, lengths = xp.atan2(sines, cosines), xp.hypot(sines, cosines)
    both, apart = turns[..., 0], turns[..., 1]
    tilt = 2.0 * xp.atan2(lengths[..., 0], lengths[..., 1]) - 0.5 * xp.pi
    angles = side_by_side(both + apart, tilt, both - apart)
    return angles - _FULL_TURN * xp.floor(angles / _FULL_TURN + 0.5)


def compose(pose_a_b: Array, pose_b_c: Array) -> Array:
    """``pose_a_c``. Poses: shape [..., 7]; they broadcast."""
    return _carried(pose_a_b[..., 3:], pose_b_c) + pose_a_b * like(pose_a_b, _PLACE)


def invert(pose_a_b: Array) -> Array:
    """``pose_b_a``. Shape [..., 7]."""
    xp = array_namespace(pose_a_b)
    rotation = pose_a_b[..., 3:]
    position = xp.matmul(pose_a_b[..., None, :3], rotation_matrix(rotation))[..., 0, :]
    return xp.concat([-position, quaternion_conjugate(rotation)], axis=-1)


def relative(pose_a_b: Array, pose_a_c: Array) -> Array:
    """``pose_b_c``: where c is, seen from b. Poses: shape [..., 7]; they broadcast."""
    apart = pose_a_c - pose_a_b * like(pose_a_b, _PLACE)
    return _carried(quaternion_conjugate(pose_a_b[..., 3:]), apart)


def transform_points(pose_a_b: Array, points_b: Array) -> Array:
    """Points of frame b in frame a. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return pose_a_b[..., None, :3] + rotate(pose_a_b[..., None, 3:], points_b)


def inverse_transform_points(pose_a_b: Array, points_a: Array) -> Array:
    """Points of frame a in frame b. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return rotate(quaternion_conjugate(pose_a_b[..., None, 3:]), points_a - pose_a_b[..., None, :3])


def _products(q: Array) -> Array:
    """wx, wy, wz, xx, ... zz. q: wxyz, shape [..., 4]; returns shape [..., 12]."""
    return (q[..., None] * q[..., None, 1:]).reshape((*q.shape[:-1], 12))


def _carried(q: Array, pose: Array) -> Array:
    """A pose in a frame with the same origin, that sees the pose's own frame turned by q. They broadcast."""
    xp = array_namespace(q, pose)
    terms = xp.concat([_products(q), q], axis=-1)
    change = xp.matmul(terms, like(q, _CARRY_FACTORS)).reshape((*q.shape[:-1], 7, 7))
    return xp.matmul(change + like(q, _STAY), pose[..., None])[..., 0]
