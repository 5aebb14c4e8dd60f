"""What a page says about how it was made."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping


def provenance(source: Mapping[str, str], seed: int, seconds: float | None = None) -> dict[str, str]:
    """Program, command, source, seed, machine and date, for people.

    Args:
        source: what it was made from, by what kind of thing that is.
        seed: of the command.
        seconds: how long it took, if known.
    """
    from datetime import datetime

    from fungrasp import __version__
    from fungrasp.evaluation.results import machine

    took = "" if seconds is None else f", made in {seconds:.0f} s"
    return {
        "Made by": f"fungrasp {__version__}",
        "Command": shlex.join(["fungrasp", *sys.argv[1:]]),
        **source,
        "Seed": str(seed),
        "Machine": machine(),
        "Date": f"{datetime.now().astimezone():%Y-%m-%d %H:%M}{took}",
    }
