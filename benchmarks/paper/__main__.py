"""``python -m benchmarks.paper``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.paper.tables import PaperTable

if __name__ == "__main__":
    main("paper", PaperTable)
