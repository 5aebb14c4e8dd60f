"""How loops are compiled, and where machine code is kept."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config

from fungrasp.files import cache_folder

NOT_COMPILED = ("__init__.py", "compiling.py", "solver.py", "terms.py")
"""Files of this folder without loops."""

SOURCES = ("optimization/compiled/*.py", "optimization/contact_forces.py", "geometry/signed_distance.py")
"""Files that the loops are made from, ``NOT_COMPILED`` left out."""


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a loop when it is first called with arguments of these types, or read it from the cache.

    It does not hold the global interpreter lock, so that threads work side by side. Sums keep their order
    (no fast math): what has just been compiled and what is read from the cache is optimized differently, and
    would otherwise not give the same bits.
    """
    # Numba's own cache, beside the sources, knows when a function's file has changed, but not when one has
    # that the function calls. Its place is read when a function is decorated.
    settings: Any = config
    place = settings.CACHE_DIR
    settings.CACHE_DIR = str(_machine_code())
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    finally:
        settings.CACHE_DIR = place


@cache
def _machine_code() -> Path:
    """A folder of its own for each state of the sources."""
    package = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for path in sorted(package.glob(pattern)):
            if path.name not in NOT_COMPILED:
                digest.update(path.read_bytes())
    return cache_folder("compiled") / digest.hexdigest()[:16]
