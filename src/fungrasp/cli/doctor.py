"""``fungrasp doctor`` and ``setup``: report what is installed, and download the hand models."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from fungrasp.cli.console import Answering, CommandResult, table


@dataclass(frozen=True)
class DoctorCommand(Answering):
    """Report programs, extras, devices, cameras and caches. Uses no network and opens no device."""

    def run(self) -> CommandResult:
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
            parts.append(f'to add an extra: pip install ".[{missing[0]}]" in the clone')
        return CommandResult(asdict(found), "\n\n".join(parts))


@dataclass(frozen=True)
class SetUpPerception(Answering):
    """Download the two hand models that `perceive` needs (8 MB, Apache-2.0) from the mediapipe wheel on the
    package index (36 MB), and cache them. Nothing is installed."""

    wheel: Path | None = None
    """A local wheel of mediapipe 0.10.21, for machines without network."""

    def run(self) -> CommandResult:
        from fungrasp.perception.hand.mediapipe_models import fetch_weights, kept_weights

        paths = list((kept_weights() if self.wheel is None else []) or fetch_weights(self.wheel))
        return CommandResult({"models": paths}, "\n".join(map(str, paths)))


COMMAND = DoctorCommand
SETUP = {"perception": SetUpPerception}
