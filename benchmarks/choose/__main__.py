"""``python -m benchmarks.choose``."""

from __future__ import annotations

from benchmarks.choose.commands import COMMAND
from benchmarks.command import main

if __name__ == "__main__":
    main("choose", COMMAND)
