"""What an audit has found, kept after each episode so that an interrupted one goes on."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.engines.audit.other_engines import AuditResult, EngineName
from benchmarks.engines.audit.replay import Replayed
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_json
from fungrasp.core.records import record_from_json

LARGEST = 64_000_000
"""Bytes of the largest file that is read."""


class KeptEpisodes:
    """A file of the episodes that are done; none if there is no path."""

    def __init__(self, path: Path | None, engine: EngineName):
        """
        Args:
            path: of the file.
            engine: that the episodes are played in.

        Raises:
            FungraspError: the file is of another engine, or damaged.
        """
        self._path = path
        self._engine: EngineName = engine
        self.known: dict[str, Replayed] = {}
        """By the name of the recording."""
        if path is None or not path.exists():
            return
        found = read_json(path, "audit", LARGEST)
        if not isinstance(found, dict) or found.get("engine") != engine:
            raise FungraspError(f"{path} is no audit by {engine}: give another file to --json")
        each = [record_from_json(Replayed, one, f"the audit {path}") for one in found.get("each", [])]
        self.known = {one.name: one for one in each}

    def add(self, one: Replayed) -> None:
        """Keep what was found of an episode.

        Raises:
            FungraspError: the file can't be written.
        """
        self.known[one.name] = one
        if self._path is not None:
            whole = AuditResult(self._engine, tuple(self.known.values())).json()
            with atomic_path(self._path) as temporary:
                temporary.write_text(json.dumps(whole, indent=1) + "\n")
