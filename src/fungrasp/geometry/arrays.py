"""Helpers for code that runs on NumPy arrays and on tensors of a device alike.

A device must not be asked for a number in the midst of a step: the processor would wait for it. What is asked
of NumPy to save work is taken for true on a device.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.geometry.poses import Array, array_namespace, constant_on


def is_numpy(array: Array) -> bool:
    """Whether the processor may look into an array at no cost."""
    return type(array) is np.ndarray


def may_be_any(flags: Array) -> bool:
    """Whether any is true or not zero; taken for true on a device."""
    return not is_numpy(flags) or bool(flags.any())


def at_least(array: Array, low: float) -> Array:
    """The larger of each number and another."""
    return np.maximum(low, array) if is_numpy(array) else array_namespace(array).clip(array, min=low)


def constant(array: Array, values: np.ndarray) -> Array:
    """Constant numbers to compute with an array: as they are for NumPy's, else on its device, copied there
    once; floating ones in its number type."""
    if isinstance(array, np.ndarray):
        return values
    dtype = array.dtype if values.dtype.kind == "f" else None
    return constant_on(array_namespace(array), array.device, dtype, values)


def rows_like(array: Array, values: Any) -> Array:
    """Values as a new array of the library, number type and device of another; flags stay flags."""
    given = np.asarray(values)
    if is_numpy(array):
        return given.copy()
    dtype = array.dtype if given.dtype.kind == "f" else None
    return array_namespace(array).asarray(given, dtype=dtype, device=array.device)


def moved_to(array: Array, values: Any) -> Array:
    """Values as an array of the library and device of another, not copied where they are; text stays
    NumPy's.

    Args:
        values: an array of that library, or NumPy's.
    """
    stays = is_numpy(array) or not is_numpy(values) or values.dtype.kind in "US"
    return values if stays else rows_like(array, values)


def copied(array: Array) -> Array:
    """A copy."""
    return array_namespace(array).asarray(array, copy=True)


def put_back(array: Array, which: Array, before: Array) -> None:
    """Give some rows the values that they had before.

    Args:
        array: shape [W, ...]; it is changed.
        which: rows, shape [W] bool.
        before: shape [W, ...].
    """
    rows = which.reshape((-1, *(1,) * (array.ndim - 1)))
    array[:] = array_namespace(array).where(rows, before, array)
