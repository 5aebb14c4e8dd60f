"""Environment variables of the processes that run beside a robot's: loops of drivers, emulators."""

from __future__ import annotations

import os
from pathlib import Path

import fungrasp


def worker_environment() -> dict[str, str]:
    """Those of this process, so that a Python process finds the package that runs here, wherever it was
    imported from, and computes in one thread: more would take the time of others."""
    paths = [str(Path(fungrasp.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
