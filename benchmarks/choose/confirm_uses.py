"""The record of how often the part "confirm" was looked at: what is looked at often is not held out."""

from __future__ import annotations

import csv
import io
from datetime import datetime
from pathlib import Path

from benchmarks.choose.pairing import PairedRates
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import read_bytes

LARGEST = 1_000_000
"""Bytes of the largest record that is read."""

COLUMNS = ("date", "decision", "a", "b", "grasps", "a_percent", "b_percent", "low", "high")


def record_use(path: Path, decision: str, first: str, second: str, rate: PairedRates) -> int:
    """Add a line to the record.

    Args:
        path: of the record (.csv); it is begun where there is none.
        decision: what is decided.
        first: the variant A.
        second: the variant B.
        rate: of all grasps; the interval is that of B less A, in points.

    Returns:
        how often the part was used, this time included.

    Raises:
        FungraspError: the file can't be read or written.
    """
    before = ",".join(COLUMNS) + "\n"
    if path.is_file():
        before = read_bytes(path, "record of uses", LARGEST).decode()
    line = io.StringIO()
    numbers = (rate.first, rate.second, *rate.interval)
    percent = [f"{100 * value:.1f}" for value in numbers]
    date = f"{datetime.now().astimezone():%Y-%m-%d %H:%M%z}"
    csv.writer(line, lineterminator="\n").writerow([date, decision, first, second, rate.grasps, *percent])
    text = before + line.getvalue()
    with atomic_path(path) as temporary:
        temporary.write_text(text)
    return len(list(csv.reader(io.StringIO(text)))) - 1
