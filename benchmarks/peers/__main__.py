"""``python -m benchmarks.peers``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.peers.comparison import COMMAND

if __name__ == "__main__":
    main("peers", COMMAND)
