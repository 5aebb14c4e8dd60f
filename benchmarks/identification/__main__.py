"""``python -m benchmarks.identification``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.identification.comparison import COMMAND

if __name__ == "__main__":
    main("identification", COMMAND)
