"""Batched work in chunks on threads, independent of their number, and the environment of child processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np

from fungrasp.core.errors import FungraspError

Result = TypeVar("Result")


def in_chunks(
    work: Callable[[np.ndarray], Result], count: int, threads: int = 0, chunk: int = 64
) -> list[Result]:
    """Return the results of ``work`` for each chunk of row numbers, in order.

    Args:
        work: function of row numbers, shape [<= chunk]; mostly NumPy or MuJoCo code, which lets other threads
            run.
        threads: number of threads; 0 for all processors.

    Raises:
        FungraspError: the number of threads is negative.
    """
    if threads < 0:
        raise FungraspError(f"the number of threads must be 0 (all processors) or more, not {threads}")
    rows = [np.arange(start, min(start + chunk, count)) for start in range(0, count, chunk)]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        return list(pool.map(work, rows))


def worker_environment() -> dict[str, str]:
    """Return the environment of a child Python process that finds the same packages and uses one thread."""
    search = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path if entry)
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **threads, "PYTHONPATH": search}
