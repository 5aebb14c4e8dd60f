"""A training as a folder: settings, plans, checkpoint, progress."""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import read_bytes
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import parse_json, read_json
from fungrasp.core.provenance import git_revision, machine
from fungrasp.task import GraspPlan
from fungrasp.training.plan_library import PlanLibrary

_log = logging.getLogger(__name__)

LARGEST_PROGRESS = 1_000_000_000
LARGEST_LIBRARY = 1 << 33
"""Bytes of the largest files that are read; a library holds plans of up to tens of thousands of grasps."""

NAMED = 5
"""Most differences to name in an error."""


class RunFolder:
    """The files of one training.

    ``config.json`` holds ``settings``, which stay as they are for as long as the folder lives, and beside
    them what may change from one call to the next.
    """

    def __init__(self, path: Path):
        """path: of the folder; it need not exist."""
        self.path = path
        self.config = path / "config.json"
        self.checkpoint = path / "checkpoint.pt"
        self.progress = path / "progress.jsonl"

    def claim(self, settings: Mapping[str, Any], **more: Any) -> None:
        """Write ``config.json``, or go on with the training that is here.

        Args:
            settings: of the training; as JSON can hold them.
            more: besides them.

        Raises:
            FungraspError: the folder holds a training with other settings, something else, or can't be
                written to.
        """
        wanted = json.loads(json.dumps(settings, allow_nan=False))
        if self.config.is_file():
            found = list(_differences(self.read_config()["settings"], wanted))
            if found:
                rest = f" and {len(found) - NAMED} more" if len(found) > NAMED else ""
                raise FungraspError(
                    f"{self.path} holds a training with other settings: {'; '.join(found[:NAMED])}{rest}. "
                    "Give the same settings to go on, or another folder"
                )
        elif self.checkpoint.exists():
            raise FungraspError(f"{self.path} holds a checkpoint and no config.json: give another folder")
        made_by = {"version": __version__, "git_revision": git_revision(), "machine": machine()}
        with atomic_path(self.config) as part:
            part.write_text(json.dumps(more | {"made_by": made_by, "settings": wanted}, indent=1) + "\n")

    def read_config(self) -> dict[str, Any]:
        """What ``claim`` wrote.

        Raises:
            FungraspError: there is none, or it is damaged.
        """
        if not self.config.is_file():
            raise FungraspError(f"{self.path} is not the folder of a training: it has no {self.config.name}")
        config = read_json(self.config, "settings of a training")
        if isinstance(config, dict) and isinstance(config.get("settings"), dict):
            return config
        raise FungraspError(f"{self.config} is damaged, or not of a training")

    def forget_progress_after(self, steps: int) -> None:
        """Drop lines of progress that an interrupted training made after its last checkpoint.

        Raises:
            FungraspError: the file can't be written.
        """
        if not self.progress.is_file():
            return
        kept = []
        text = read_bytes(self.progress, "progress of a training", LARGEST_PROGRESS).decode(errors="replace")
        for line in text.splitlines(keepends=True):
            with contextlib.suppress(FungraspError, KeyError, TypeError):
                if parse_json(line, str(self.progress))["steps"] <= steps:
                    kept.append(line)
        with atomic_path(self.progress) as part:
            part.write_text("".join(kept))

    def add_progress(self, numbers: Mapping[str, Any]) -> None:
        """One more line of progress.

        Raises:
            FungraspError: the file can't be written.
        """
        try:
            with self.progress.open("a") as stream:
                stream.write(json.dumps(numbers) + "\n")
        except OSError as error:
            raise FungraspError(f"cannot write {self.progress}: {error.strerror or error}") from error


def kept_library(path: Path, key: str, plan: Callable[[], PlanLibrary]) -> PlanLibrary:
    """A planned library from its file; if it isn't there, can't be read or is another one, it is planned and
    kept.

    Args:
        path: of the file (.npz).
        key: digest of all that the library depends on.
        plan: makes it.

    Raises:
        FungraspError: planning fails, or the file can't be written.
    """
    if path.is_file():
        try:
            arrays = read_npz(path, "plan library", largest=LARGEST_LIBRARY)
            if str(arrays.pop("key")) == key:
                group = arrays.pop("group")
                return PlanLibrary(GraspPlan.from_arrays(arrays), group)
            _log.warning("%s belongs to other grasps or settings: planning again", path)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            _log.warning("%s is unreadable (%s): planning again", path, error)
    library = plan()
    with atomic_path(path) as part, part.open("wb") as stream:
        arrays = {"key": np.array(key), "group": library.group} | library.plans.arrays()
        np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]
    return library


def _differences(there: Any, here: Any, name: str = "") -> Iterator[str]:
    """In words, one for each value that is not the same."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in dict.fromkeys([*there, *here]):
            yield from _differences(there.get(key), here.get(key), f"{name}.{key}".strip("."))
    elif there != here:
        yield f"{name} is {_short(there)} there, {_short(here)} here"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
