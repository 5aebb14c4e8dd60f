"""The commands of ``python -m benchmarks.perception``."""

from __future__ import annotations

from benchmarks.perception.captures import BenchPerception
from benchmarks.perception.depth import BenchDepth

COMMAND = {"captures": BenchPerception, "depth": BenchDepth}
"""By subcommand name."""
