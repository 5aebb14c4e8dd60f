"""What holds for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

REAL_TIME = (
    "cli",
    "deployment",
    "core/test_jobs.py",
    "reliability",
    "robots",
    "ros2",
    "viewer",
    "benchmarks/fault_series",
    "benchmarks/test_wire.py",
)
"""Folders and files of tests in real time: devices with watchdogs, processes that wait for each other."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Two more tries for tests in real time: a computer that pauses for a second stops an arm, as it must."""
    here = Path(__file__).parent
    for item in items:
        if any(item.path.is_relative_to(here / name) for name in REAL_TIME):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=2))
