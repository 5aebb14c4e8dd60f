"""Runs a benchmark's command from the arguments of this process."""

from __future__ import annotations

import sys
from typing import Any, NoReturn

from fungrasp.cli.main import run_command
from fungrasp.core.errors import FungraspError


def main(name: str, command: Any) -> NoReturn:
    """Run ``python -m benchmarks.<name>`` and end the process; bad input ends in one line and status 2.

    Args:
        name: of the benchmark.
        command: a dataclass with a method ``run``, or a table of them by subcommand name.
    """
    sys.exit(run_command(f"python -m benchmarks.{name}", command, sys.argv[1:]))


def check_positive(**values: int) -> None:
    """Complain about options below 1.

    Raises:
        FungraspError: one is.
    """
    for name, value in values.items():
        if value < 1:
            raise FungraspError(f"--{name} must be at least 1, not {value}")
