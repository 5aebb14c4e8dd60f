"""What holds for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

REAL_TIME = (
    "cli",
    "deployment",
    "core/jobs",
    "reliability",
    "robots",
    "ros2",
    "viewer",
    "benchmarks/fault_series",
    "benchmarks/wire",
)
"""Folders of tests in real time: emulated devices with watchdogs, processes that wait for each other."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Two more tries for tests in real time: a computer that pauses for a second stops an arm, as it must."""
    folders = tuple(str(Path(__file__).parent / name) + "/" for name in REAL_TIME)
    for item in items:
        if str(item.path).startswith(folders):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=2))
