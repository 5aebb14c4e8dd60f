"""The commands of ``python -m benchmarks.speed``."""

from __future__ import annotations

from benchmarks.speed.cluster import BenchCluster
from benchmarks.speed.drivers import BenchRobot
from benchmarks.speed.planning import BenchPlanning

COMMAND = {
    "planning": BenchPlanning,
    "cluster": BenchCluster,
    "drivers": BenchRobot,
}
"""By subcommand name."""
