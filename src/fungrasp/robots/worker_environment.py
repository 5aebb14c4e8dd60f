"""Environment variables of the processes that run beside a robot's: loops of drivers, emulators."""

from __future__ import annotations

import os
import sys


def worker_environment() -> dict[str, str]:
    """Those of this process, so that a Python process finds the packages that this one finds, and computes in
    one thread: more would take the time of others."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
