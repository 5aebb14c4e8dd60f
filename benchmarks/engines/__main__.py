"""``python -m benchmarks.engines``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.engines.audit import COMMAND

if __name__ == "__main__":
    main("engines", COMMAND)
