"""``fungrasp doctor``: what is installed, which extras work, which devices are there, where caches are."""

from __future__ import annotations

from dataclasses import dataclass

from fungrasp.cli.console import Answer, Answering, table


@dataclass(frozen=True)
class DoctorCommand(Answering):
    """Say what is installed, which extras work, which devices and cameras are there, where caches are and how
    large. Nothing is asked of a network, and no device is opened."""

    def run(self) -> Answer:
        from fungrasp.core.provenance import diagnose

        found = diagnose()
        extras = [
            (e.name, "missing: " + ", ".join(e.missing) if e.missing else "ready") for e in found.extras
        ]
        caches = [
            (c.what, c.path, f"{c.megabytes:.1f} MB" if c.exists else "not there") for c in found.caches
        ]
        parts = [
            table([("program", "version"), *found.programs], left=None),
            table([("extra", "state"), *extras], left=None),
            table([("device", "state"), *found.devices], left=None),
            table([("cache", "where", "size"), *caches], left=(0, 1)),
        ]
        missing = [e.name for e in found.extras if e.missing]
        if missing:
            parts.append(f'to add an extra: pip install "fungrasp[{missing[0]}]"')
        return Answer(found.as_json(), "\n\n".join(parts))


COMMAND = DoctorCommand
