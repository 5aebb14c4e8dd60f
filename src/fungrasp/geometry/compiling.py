"""How loops are compiled, and where machine code is kept.

Numba compiles a function anew for each combination of argument types and spends most of its time on what a
function mentions, not on what it does. A cold start stays short where loops

- take C-contiguous arrays of float64, int64 and bool, few of them, and are called with one kind of each;
- assign elements, not slices, and sort, sum and fill by loops of their own: NumPy's functions in Numba are
  long programs, which are compiled as well;
- start counters with ``np.int64(0)``, as a literal zero is a type of its own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import config

from fungrasp.core.files import cache_folder

SOURCES = (
    "geometry/compiling.py",
    "geometry/distance_queries.py",
    "geometry/signed_distance.py",
    "optimization/*.py",
    "perception/compiled_loops.py",
)
"""Files that the loops are made from."""

jit: Any = numba.njit

OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Loops do not hold the global interpreter lock, so that threads work side by side. Sums keep their order (no
fast math): what has just been compiled and what is read from the cache is optimized differently, and would
otherwise not give the same bits."""


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a loop when it is first called with arguments of these types, or read it from the cache."""
    # Numba's own cache, beside the sources, knows when a function's file has changed, but not when one has
    # that the function calls. Its place is read when a function is decorated.
    settings: Any = config
    place = settings.CACHE_DIR
    settings.CACHE_DIR = str(_machine_code())
    try:
        return jit(cache=True, **OPTIONS)(function)
    finally:
        settings.CACHE_DIR = place


def compiled_part(function: Callable[..., Any]) -> Any:
    """Compile what only compiled loops call: it is kept with them."""
    return jit(no_cpython_wrapper=True, **OPTIONS)(function)


def plain(array: np.ndarray, kind: type = float) -> np.ndarray:
    """A writable, contiguous copy: loops are compiled anew for every other kind of array."""
    return np.array(array, dtype=kind, order="C")


@cache
def _machine_code() -> Path:
    """A folder of its own for each state of the sources."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for path in sorted(package.glob(pattern)):
            digest.update(path.read_bytes())
    return cache_folder("compiled") / digest.hexdigest()[:16]
