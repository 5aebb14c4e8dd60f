"""Batched rigid transforms on any array-API library (NumPy, torch, ...).

A pose is 7 numbers ``[x y z qw qx qy qz]``: a position [m] and a unit quaternion. Arrays have any leading
batch shape and broadcast. ``pose_a_b`` maps points of frame b to frame a: ``pose_a_c = compose(pose_a_b,
pose_b_c)``.

Quaternion products are matrix products, because the number of calls determines the time for a single pose.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import array_api_compat
import numpy as np

Array = Any
"""An array of NumPy, torch or another array-API library."""
TINY = 1e-30
"""Added to divisors that may be zero; it does not change others."""


_HAMILTON = np.array(
    [
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]],
        [[0, 0, 1, 0], [0, 0, 0, -1], [-1, 0, 0, 0], [0, 1, 0, 0]],
        [[0, 0, 0, 1], [0, 0, 1, 0], [0, -1, 0, 0], [-1, 0, 0, 0]],
    ],
    dtype=float,
)
"""Products of the units 1, i, j, k: first factor by row, second factor by column."""
_RIGHT_FACTOR = np.reshape(np.moveaxis(_HAMILTON, 0, -1), (4, 16))
"""Maps a quaternion ``b`` to the matrix M with ``a b = M a``, in row-major order."""
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
_PLACE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
"""Mask of a pose's position."""


def _turn_factors() -> np.ndarray:
    """Return the map from a unit quaternion's products wx, wy, wz, xx, ... zz to its rotation matrix minus
    the identity, in row-major order."""
    scalar, axis = np.zeros((3, 3, 3)), np.zeros((3, 3, 3, 3))
    for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        axis[y, y, x, x] = axis[z, z, x, x] = -2.0
        axis[x, y, x, y] = axis[x, y, y, x] = 2.0
        scalar[z, y, x], scalar[z, x, y] = 2.0, -2.0
    return np.concatenate([np.reshape(scalar, (3, 9)), np.reshape(axis, (9, 9))])


_TURN_FACTORS = _turn_factors()
_IDENTITY = np.eye(3)


def _carry_factors() -> np.ndarray:
    """Return the map from the same products and w, x, y, z to the 7x7 matrix that rotates a pose, in
    row-major order; the identity is subtracted from its position block."""
    result = np.zeros((16, 7, 7))
    result[:12, :3, :3] = np.reshape(_TURN_FACTORS, (12, 3, 3))
    result[12:, 3:, 3:] = np.swapaxes(_HAMILTON, 1, 2)
    return np.reshape(result, (16, 49))


_CARRY_FACTORS = _carry_factors()
_STAY = np.diag(_PLACE)
_CONSTANTS: dict[tuple[Any, ...], Array] = {}
"""Cache of ``constant_on``."""
_MOST_CONSTANTS = 1000
_FULL_TURN = 2.0 * np.pi
_EULER_HALVES = np.array([[1.0, 0, 1.0, 0], [0, 1.0, 0, 1.0], [1.0, 0, -1.0, 0], [0, 1.0, 0, -1.0]])
"""Maps a quaternion to ``w + y, x + z, w - y, x - z``."""


def array_namespace(array: Array, *others: Array) -> Any:
    """Return the array-API namespace of arrays of one library."""
    # NumPy implements the array API, and detecting a library takes longer than a quaternion product.
    if type(array) is np.ndarray:
        return np
    return array_api_compat.array_namespace(array, *others)


def like(array: Array, values: np.ndarray) -> Array:
    """Return constant values as an array of the library, dtype and device of another. Do not write to it."""
    if type(array) is np.ndarray:
        return values if array.dtype == values.dtype else values.astype(array.dtype)
    return constant_on(array_namespace(array), array.device, array.dtype, values)


def constant_on(library: Any, device: Any, dtype: Any, values: np.ndarray) -> Array:
    """Return constant values on a device, copied once because each copy waits for the device.

    Args:
        dtype: dtype of the library; that of the values if None.
    """
    key = library.__name__, str(device), str(dtype), values.dtype.str, values.shape, values.tobytes()
    if key not in _CONSTANTS:
        if len(_CONSTANTS) >= _MOST_CONSTANTS:
            _CONSTANTS.clear()
        # Autograd in torch needs tensors that were not created in inference mode.
        mode = getattr(library, "inference_mode", None)
        with mode(False) if mode else nullcontext():
            _CONSTANTS[key] = library.asarray(values, dtype=dtype, device=device, copy=True)
    return _CONSTANTS[key]


def stack(*arrays: Array) -> Array:
    """Stack arrays along a new first axis, two to three times as fast as the libraries' functions."""
    return array_namespace(*arrays).concat([array[None] for array in arrays])


def side_by_side(*parts: Array) -> Array:
    """Stack arrays along a new last axis, twice as fast as NumPy's ``stack``."""
    first = parts[0]
    if type(first) is not np.ndarray:
        return array_namespace(*parts).stack(parts, axis=-1)
    shape = (*first.shape, len(parts))
    result = np.empty(shape, dtype=first.dtype)
    for number, part in enumerate(parts):
        result[..., number] = part
    return result


def clip(array: Array, low: Any, high: Any) -> Array:
    """Clip an array to limits, numbers or arrays, three times as fast as NumPy's ``clip``."""
    if type(array) is np.ndarray:
        return np.minimum(np.maximum(array, low), high)
    return array_namespace(array).clip(array, low, high)


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product ``a b``. a, b: wxyz, shape [..., 4]."""
    xp = array_namespace(a, b)
    factor = xp.matmul(b, like(b, _RIGHT_FACTOR)).reshape((*b.shape, 4))
    return xp.vecdot(factor, a[..., None, :])


def quaternion_conjugate(q: Array) -> Array:
    """Return the inverse of a unit quaternion. q: wxyz, shape [..., 4]."""
    return q * like(q, _CONJUGATE)


def cross(a: Array, b: Array) -> Array:
    """Return the cross product with broadcasting, which the array API lacks. Shape [..., 3]."""
    if type(a) is not np.ndarray:
        xp = array_namespace(a, b)
        return xp.linalg.cross(*xp.broadcast_arrays(a, b))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return side_by_side(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def norm(v: Array) -> Array:
    """Return the length of vectors, shape [..., 1]. v: shape [..., N]."""
    xp = array_namespace(v)
    return xp.sqrt(xp.vecdot(v, v))[..., None]


def rotate(q: Array, v: Array) -> Array:
    """Rotate vectors. q: wxyz, shape [..., 4]; v: shape [..., 3]."""
    axis = q[..., 1:]
    t = 2.0 * cross(axis, v)
    return v + q[..., :1] * t + cross(axis, t)


def quaternion_from_rotation_vector(v: Array) -> Array:
    """Return the exponential map, wxyz, shape [..., 4]. v: axis times angle [rad], shape [..., 3]."""
    xp = array_namespace(v)
    angle = norm(v) + TINY
    half = 0.5 * angle
    return xp.concat([xp.cos(half), xp.sin(half) / angle * v], axis=-1)


def rotation_vector(q: Array) -> Array:
    """Return the logarithm [rad], shape [..., 3], norm <= pi. q: wxyz, shape [..., 4]."""
    xp = array_namespace(q)
    cosine, axis = q[..., :1], q[..., 1:]
    sine = norm(axis)
    half = xp.atan2(sine, xp.abs(cosine))
    return axis * xp.copysign(2.0 * half / (sine + TINY), cosine)


def turned_towards(q: Array, goal: Array, angle: Array) -> Array:
    """Rotate orientations toward a goal along the shorter way.

    Args:
        q: start, wxyz, shape [..., 4].
        goal: wxyz, shape [..., 4].
        angle: maximum rotation [rad], shape [..., 1].
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
    """Return rotation matrices, shape [..., 3, 3]. q: wxyz, shape [..., 4]."""
    change = array_namespace(q).matmul(_products(q), like(q, _TURN_FACTORS))
    return change.reshape((*q.shape[:-1], 3, 3)) + like(q, _IDENTITY)


def euler_angles(q: Array) -> Array:
    """Return intrinsic x-y-z Euler angles [rad], shape [..., 3]. The second is at most a right angle; at a
    right angle only the sum or difference of the others is defined.

    With half angles a, b, c: ``w + y = (cos b + sin b) cos(a + c)``, ``x + z = (cos b + sin b) sin(a + c)``,
    and the same with ``-`` for each ``+``. q: wxyz, shape [..., 4].
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
    """Return ``pose_a_c``. Poses: shape [..., 7]."""
    return _carried(pose_a_b[..., 3:], pose_b_c) + pose_a_b * like(pose_a_b, _PLACE)


def invert(pose_a_b: Array) -> Array:
    """Return ``pose_b_a``, shape [..., 7]."""
    xp = array_namespace(pose_a_b)
    rotation = pose_a_b[..., 3:]
    position = xp.matmul(pose_a_b[..., None, :3], rotation_matrix(rotation))[..., 0, :]
    return xp.concat([-position, quaternion_conjugate(rotation)], axis=-1)


def relative(pose_a_b: Array, pose_a_c: Array) -> Array:
    """Return ``pose_b_c``, the pose of c in frame b. Poses: shape [..., 7]."""
    apart = pose_a_c - pose_a_b * like(pose_a_b, _PLACE)
    return _carried(quaternion_conjugate(pose_a_b[..., 3:]), apart)


def interpolate_pose(pose: Array, goal: Array, share: Array | float) -> Array:
    """Interpolate poses: straight translation, rotation about a fixed axis by the shorter way.

    Args:
        pose, goal: shape [W, 7].
        share: fraction of the way, shape [W, 1] or a number.
    """
    turn = quaternion_from_rotation_vector(share * rotation_vector(relative(pose, goal)[:, 3:]))
    place = pose[:, :3] + share * (goal[:, :3] - pose[:, :3])
    return array_namespace(pose).concat([place, quaternion_multiply(pose[:, 3:], turn)], axis=1)


def transform_points(pose_a_b: Array, points_b: Array) -> Array:
    """Transform points from frame b to frame a. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return pose_a_b[..., None, :3] + rotate(pose_a_b[..., None, 3:], points_b)


def inverse_transform_points(pose_a_b: Array, points_a: Array) -> Array:
    """Transform points from frame a to frame b. pose: shape [..., 7]; points: [m], shape [..., P, 3]."""
    return rotate(quaternion_conjugate(pose_a_b[..., None, 3:]), points_a - pose_a_b[..., None, :3])


def _products(q: Array) -> Array:
    """Return the products wx, wy, wz, xx, ... zz, shape [..., 12]. q: wxyz, shape [..., 4]."""
    return (q[..., None] * q[..., None, 1:]).reshape((*q.shape[:-1], 12))


def _carried(q: Array, pose: Array) -> Array:
    """Rotate a pose about the origin by q. Arguments broadcast."""
    xp = array_namespace(q, pose)
    terms = xp.concat([_products(q), q], axis=-1)
    change = xp.matmul(terms, like(q, _CARRY_FACTORS)).reshape((*q.shape[:-1], 7, 7))
    return xp.matmul(change + like(q, _STAY), pose[..., None])[..., 0]
