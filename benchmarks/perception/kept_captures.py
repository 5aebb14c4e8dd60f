"""Measured captures of a long run, kept until all are done, so that an interrupted run can go on."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.perception.measurements import AbsentResult, CaptureResult, HandResult, PoseResult, Seconds
from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path
from fungrasp.formats.json_file import read_json
from fungrasp.grasps import HumanGrasp


class KeptCaptures:
    """Results by the capture's number, in one JSON file."""

    def __init__(self, path: str | Path, key: str):
        """
        Args:
            path: of the file; it need not exist, and one that can't be read counts as empty.
            key: digest of all that the numbers depend on; a file kept with another one counts as empty.
        """
        self._path, self._key = Path(path), key
        self._rows: dict[str, Any] = {}
        if self._path.is_file():
            try:
                content = read_json(self._path, "kept results")
                self._rows = content["rows"] if content["key"] == key else {}
            except (FungraspError, KeyError, TypeError):
                self._rows = {}

    def load(self, index: int) -> CaptureResult | None:
        """The result of a capture, None if it was not kept."""
        row = self._rows.get(str(index))
        return None if row is None else _read(row)

    def save(self, index: int, result: CaptureResult) -> None:
        """Keep a result, on disk when this returns.

        Raises:
            FungraspError: the file can't be written.
        """
        self._rows[str(index)] = asdict(result)
        with atomic_path(self._path) as temporary:
            temporary.write_text(
                json.dumps({"key": self._key, "rows": self._rows}, default=np.ndarray.tolist)
            )

    def remove(self) -> None:
        """Delete the file, if there is one."""
        self._path.unlink(missing_ok=True)


def _read(row: dict[str, Any]) -> CaptureResult:
    wrong, absent, perceived = row["wrong_mesh"], row["absent"], row["perceived"]
    return CaptureResult(
        object_name=row["object_name"],
        hand=HandResult(**row["hand"]),
        masked=PoseResult(**row["masked"]),
        unmasked=PoseResult(**row["unmasked"]),
        wrong_mesh=None if wrong is None else PoseResult(**wrong),
        absent=None if absent is None else AbsentResult(absent["hand_score"], PoseResult(**absent["pose"])),
        seconds={stage: Seconds(**seconds) for stage, seconds in row["seconds"].items()},
        grasp=_grasp(row["grasp"]),
        perceived=None if perceived is None else _grasp(perceived),
        sure=row["sure"],
        others=tuple(_grasp(other) for other in row["others"]),
    )


def _grasp(row: dict[str, Any]) -> HumanGrasp:
    values: dict[str, Any] = {
        field.name: np.array(row[field.name]) if isinstance(row[field.name], list) else row[field.name]
        for field in fields(HumanGrasp)
    }
    return HumanGrasp(**values)
