"""``python -m benchmarks.paper``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.paper.commands import COMMAND

if __name__ == "__main__":
    main("paper", COMMAND)
