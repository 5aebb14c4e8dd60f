"""``python -m benchmarks.perception``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.perception.commands import COMMAND

if __name__ == "__main__":
    main("perception", COMMAND)
