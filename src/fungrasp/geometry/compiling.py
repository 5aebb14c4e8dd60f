"""Compilation of loops with Numba, and the cache of machine code.

Numba compiles a function for each combination of argument types, and compilation time depends mostly on the
functions and types that it uses. To keep a cold start short, loops

- take few arguments: C-contiguous arrays of float64, int64 or bool, each always of the same type;
- assign elements, not slices, and sort, sum and fill in explicit loops, because Numba would also compile its
  long versions of NumPy's functions;
- start counters with ``np.int64(0)``, because a literal zero has its own type.
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
"""Source files of compiled loops."""

jit: Any = numba.njit

OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Loops release the global interpreter lock, so that threads run in parallel. Without fast math, sums keep
their order: otherwise fresh code and cached code, which are optimized differently, would differ in bits."""


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a loop on its first call with arguments of these types, or read it from the cache."""
    # Numba detects changes of a function's own file, but not of files with functions that it calls. The cache
    # directory is read when a function is decorated.
    settings: Any = config
    place = settings.CACHE_DIR
    settings.CACHE_DIR = str(_machine_code())
    try:
        return jit(cache=True, **OPTIONS)(function)
    finally:
        settings.CACHE_DIR = place


def compiled_part(function: Callable[..., Any]) -> Any:
    """Compile a function that only compiled loops call. It is cached with them."""
    return jit(no_cpython_wrapper=True, **OPTIONS)(function)


def plain(array: np.ndarray, kind: type = float) -> np.ndarray:
    """Return a writable, contiguous copy. Loops would be recompiled for other kinds of arrays."""
    return np.array(array, dtype=kind, order="C")


@cache
def _machine_code() -> Path:
    """Return the cache folder of the current sources."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for path in sorted(package.glob(pattern)):
            digest.update(path.read_bytes())
    return cache_folder("compiled") / digest.hexdigest()[:16]
