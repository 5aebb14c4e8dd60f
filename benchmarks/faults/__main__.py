"""``python -m benchmarks.faults``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.faults.devices import COMMAND

if __name__ == "__main__":
    main("faults", COMMAND)
