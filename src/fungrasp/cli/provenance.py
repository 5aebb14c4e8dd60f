"""What a page says about how it was made."""

from __future__ import annotations

from collections.abc import Mapping


def page_provenance(source: Mapping[str, str], seed: int, seconds: float | None = None) -> dict[str, str]:
    """Program, command, source, seed, machine and date, for people.

    Args:
        source: what it was made from, by what kind of thing that is.
        seed: of the command.
        seconds: how long it took [s], if known.
    """
    from fungrasp.provenance import run_record

    record = run_record(seed)
    revision = f", revision {record['revision'][:12]}" if record["revision"] else ""
    took = "" if seconds is None else f", made in {seconds:.0f} s"
    return {
        "Made by": f"fungrasp {record['version']}{revision}",
        "Command": record["command"],
        **source,
        "Seed": str(seed),
        "Machine": record["machine"],
        "Date": f"{record['date']}{took}",
    }
