"""The commands of ``python -m benchmarks.speed``."""

from __future__ import annotations

from benchmarks.speed.cluster import BenchCluster
from benchmarks.speed.drivers import BenchRobot
from benchmarks.speed.planning import BenchPlanning
from benchmarks.speed.retarget import Retargeting
from benchmarks.speed.training import Training

COMMAND = {
    "retarget": Retargeting,
    "planning": BenchPlanning,
    "training": Training,
    "cluster": BenchCluster,
    "drivers": BenchRobot,
}
"""By subcommand name."""
