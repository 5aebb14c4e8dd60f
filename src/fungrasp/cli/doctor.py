"""``fungrasp doctor``: what is installed, which extras work, which devices are there, where caches are."""

from __future__ import annotations

import json
from dataclasses import dataclass


@dataclass(frozen=True)
class DoctorCommand:
    """Say what is installed, which extras work, which devices and cameras are there, where caches are and how
    large. Nothing is asked of a network, and no device is opened."""

    json: bool = False
    """Print it as JSON."""

    def run(self) -> None:
        from fungrasp.diagnosis import diagnose
        from fungrasp.text_table import table

        found = diagnose()
        if self.json:
            print(json.dumps(found.as_json(), indent=1))
            return
        print(table([("program", "version"), *found.programs], left=None))
        print()
        extras = [
            (e.name, "missing: " + ", ".join(e.missing) if e.missing else "ready") for e in found.extras
        ]
        print(table([("extra", "state"), *extras], left=None))
        print()
        print(table([("device", "state"), *found.devices], left=None))
        print()
        caches = [
            (c.what, c.path, f"{c.megabytes:.1f} MB" if c.exists else "not there") for c in found.caches
        ]
        print(table([("cache", "where", "size"), *caches], left=(0, 1)))
        missing = [e.name for e in found.extras if e.missing]
        if missing:
            print(f"\nto add an extra: pip install 'fungrasp[{missing[0]}]'")


COMMAND = DoctorCommand
