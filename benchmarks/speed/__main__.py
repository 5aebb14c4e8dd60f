"""``python -m benchmarks.speed``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.speed.commands import COMMAND

if __name__ == "__main__":
    main("speed", COMMAND)
