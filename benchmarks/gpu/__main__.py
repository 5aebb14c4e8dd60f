"""``python -m benchmarks.gpu``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.gpu.many_worlds import COMMAND

if __name__ == "__main__":
    main("gpu", COMMAND)
