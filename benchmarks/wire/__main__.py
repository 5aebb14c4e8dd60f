"""``python -m benchmarks.wire``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.wire.series import COMMAND

if __name__ == "__main__":
    main("wire", COMMAND)
