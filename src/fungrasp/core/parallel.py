"""Batched work in chunks on a few threads; the result does not depend on their number. What processes beside
this one find."""

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
    """``work`` on the row numbers of each chunk, in order.

    Args:
        work: given row numbers, shape [<= chunk]; mostly NumPy or MuJoCo, which let other threads run.
        threads: 0 means all processors.

    Raises:
        FungraspError: a negative number of threads.
    """
    if threads < 0:
        raise FungraspError(f"the number of threads must be 0 (all processors) or more, not {threads}")
    rows = [np.arange(start, min(start + chunk, count)) for start in range(0, count, chunk)]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        return list(pool.map(work, rows))


def worker_environment() -> dict[str, str]:
    """Environment in which a Python process finds the packages that this one finds, and computes in one
    thread: more would take the time of others."""
    search = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path if entry)
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **threads, "PYTHONPATH": search}
