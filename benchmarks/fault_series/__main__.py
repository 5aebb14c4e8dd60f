"""``python -m benchmarks.fault_series``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.fault_series.series import COMMAND

if __name__ == "__main__":
    main("fault_series", COMMAND)
