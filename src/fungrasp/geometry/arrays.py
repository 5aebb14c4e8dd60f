"""Helpers for code that runs on NumPy arrays and on device tensors.

Reading a number from a device in the middle of a step would make the CPU wait. Checks that only save work on
NumPy are therefore assumed true on a device.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.geometry.poses import Array, array_namespace, constant_on


def is_numpy(array: Array) -> bool:
    """Return whether the CPU can read the array at no cost."""
    return type(array) is np.ndarray


def may_be_any(flags: Array) -> bool:
    """Return whether any entry is nonzero; always true on a device."""
    return not is_numpy(flags) or bool(flags.any())


def at_least(array: Array, low: float) -> Array:
    """Clip an array from below."""
    return np.maximum(low, array) if is_numpy(array) else array_namespace(array).clip(array, min=low)


def constant(array: Array, values: np.ndarray) -> Array:
    """Return constant values for computing with ``array``: unchanged for NumPy, otherwise on its device,
    copied once; floating-point values get its dtype."""
    if isinstance(array, np.ndarray):
        return values
    dtype = array.dtype if values.dtype.kind == "f" else None
    return constant_on(array_namespace(array), array.device, dtype, values)


def rows_like(array: Array, values: Any) -> Array:
    """Return values as a new array of the library and device of another; floating-point values get its
    dtype."""
    given = np.asarray(values)
    if is_numpy(array):
        return given.copy()
    dtype = array.dtype if given.dtype.kind == "f" else None
    return array_namespace(array).asarray(given, dtype=dtype, device=array.device)


def moved_to(array: Array, values: Any) -> Array:
    """Return values as an array of the library and device of another, copied only if necessary. Strings stay
    in NumPy.

    Args:
        values: an array of that library or a NumPy array.
    """
    stays = is_numpy(array) or not is_numpy(values) or values.dtype.kind in "US"
    return values if stays else rows_like(array, values)


def copied(array: Array) -> Array:
    """Return a copy."""
    return array_namespace(array).asarray(array, copy=True)


def put_back(array: Array, which: Array, before: Array) -> None:
    """Restore previous values of some rows in place.

    Args:
        array: shape [W, ...], modified.
        which: rows, shape [W] bool.
        before: shape [W, ...].
    """
    rows = which.reshape((-1, *(1,) * (array.ndim - 1)))
    array[:] = array_namespace(array).where(rows, before, array)
