"""``python -m benchmarks.perception``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.perception.recorded import Recorded, Rendered

COMMAND = {"recorded": Recorded, "rendered": Rendered}
"""By subcommand name."""

if __name__ == "__main__":
    main("perception", COMMAND)
