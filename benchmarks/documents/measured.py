"""What tables have in common: results, cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fungrasp.evaluation.result_files import ResultFile, read_result

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "lab" / "results"
NONE = "—"
HANDS = {
    "allegro": "Allegro",
    "shadow": "Shadow",
    "faive": "Faive P0",
    "inspire": "Inspire RH56",
    "leap": "LEAP",
}


class Table(NamedTuple):
    """A table and where its numbers come from."""

    head: Sequence[str]
    """Names of the columns."""
    rows: Sequence[Sequence[str]]
    """Cells, as many in each row as columns."""
    results: Sequence[str]
    """Names of the result files."""


def recorded(name: str) -> Callable[[], Table]:
    """A table whose cells are kept as they were written down, with their head in the header."""

    def build() -> Table:
        result = read(name)
        return Table(result.header["head"], [list(row.values()) for row in result.rows], [name])

    return build


def read(name: str) -> ResultFile:
    """A result. name: of its file in ``RESULTS``."""
    return read_result(RESULTS / f"{name}.json")


def percent(share: float | None) -> str:
    """A share, 0 to 1, in percent."""
    return NONE if share is None else f"{100 * share:.1f} %"


def with_interval(result: Mapping[str, Any]) -> str:
    """A rate with its 95 % interval."""
    low, high = result["success_interval"]
    return f"{percent(result['success_rate'])} ({100 * low:.0f} – {100 * high:.0f})"


def of_count(share: Mapping[str, Any]) -> str:
    """A share as counts."""
    return f"{round(share['rate'] * share['count'])} of {share['count']}"


def slip(mean: float, median: float | None) -> str:
    """Mean and median of a slip [mm/s]."""
    return f"{mean:.1f} / {NONE if median is None else f'{median:.1f}'}"


def milliseconds(seconds: Sequence[float]) -> str:
    """Median and 95th percentile of some times [s]."""
    if not seconds:
        return NONE
    return f"{1e3 * np.median(seconds):.0f} / {1e3 * np.percentile(seconds, 95):.0f}"
