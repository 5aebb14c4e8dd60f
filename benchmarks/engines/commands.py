"""The commands of ``python -m benchmarks.engines``."""

from __future__ import annotations

from benchmarks.engines.audit.command import Audit
from benchmarks.engines.simulation import Simulation

COMMAND = {"speed": Simulation, "audit": Audit}
"""By subcommand name."""
