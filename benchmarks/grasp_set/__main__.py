"""``python -m benchmarks.grasp_set``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.grasp_set.commands import COMMAND

if __name__ == "__main__":
    main("grasp_set", COMMAND)
