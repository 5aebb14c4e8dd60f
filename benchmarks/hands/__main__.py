"""``python -m benchmarks.hands``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.hands.added_hands import COMMAND

if __name__ == "__main__":
    main("hands", COMMAND)
