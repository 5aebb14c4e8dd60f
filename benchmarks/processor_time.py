"""Processor time of another process."""

from __future__ import annotations

import os
from pathlib import Path


def processor_time(process: int | None) -> float:
    """Of a process, all its threads [s]; 0 where there is none or the system doesn't tell."""
    stat = Path(f"/proc/{process}/stat")
    if process is None or not stat.is_file():
        return 0.0

    # After the name, which may hold spaces: fields 14 and 15 of proc(5) are user and system time.
    fields = stat.read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
