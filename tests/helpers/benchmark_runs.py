"""Runs benchmarks in the process of a test."""

from __future__ import annotations

import importlib
from typing import Any

from fungrasp.cli.main import run_command

MODULES = {
    "engines": "__main__",
    "fault_series": "__main__",
    "grasp_set": "__main__",
    "paper": "__main__",
    "peers": "comparison",
}
"""Where the command of a benchmark is that is a folder."""


def run_benchmark(capsys: Any, name: str, *arguments: object) -> tuple[int, str, str]:
    """Status and output of ``python -m benchmarks.<name>``."""
    place = f"{name}.{MODULES[name]}" if name in MODULES else name
    command = importlib.import_module(f"benchmarks.{place}").COMMAND
    status = run_command(f"python -m benchmarks.{name}", command, [str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err
