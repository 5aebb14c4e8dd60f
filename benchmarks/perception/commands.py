"""The commands of ``python -m benchmarks.perception``."""

from __future__ import annotations

from benchmarks.perception.depth import BenchDepth
from benchmarks.perception.lifts import Lifts
from benchmarks.perception.looks import Looks
from benchmarks.perception.recorded import Recorded
from benchmarks.perception.tracking import Tracking
from benchmarks.perception.varied import Varied
from benchmarks.perception.verdict import Verdict

COMMAND = {
    "recorded": Recorded,
    "varied": Varied,
    "lifts": Lifts,
    "verdict": Verdict,
    "looks": Looks,
    "tracking": Tracking,
    "depth": BenchDepth,
}
"""By subcommand name."""
