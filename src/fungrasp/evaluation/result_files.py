"""Result files: a small JSON header and a CSV table with one row per episode.

The header has the provenance (command, revision, versions, seed, machine, date) and the summary; its keys
``rows``, ``columns`` and ``sha256`` give the table's file, the type of each column and the table's digest.
Nested values have dotted column names, ``seconds.hand.cpu``. A single JSON file with rows as lists, as
written by ``fungrasp evaluate --json``, can also be read.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, check_suffix
from fungrasp.core.formats.checks import one_line, read_bytes
from fungrasp.core.formats.text_files import read_json

ROW_LISTS = ("trials", "each")
"""Keys of the row lists in a single JSON file."""
PART = "part"
"""Column with the location of a row in a single JSON file, "robustness/nominal"; absent if all rows have the
same location."""

LARGEST = 64_000_000
"""Largest size of a header or table that is read [bytes]."""

Row = dict[str, Any]
"""Values by column: bool, int, float, str, or None if not measured."""


@dataclass(frozen=True)
class ResultFile:
    """Content of a result file."""

    header: dict[str, Any]
    """Provenance and summary."""
    rows: list[Row]
    """One row per episode (in a perception benchmark: per capture)."""

    def frame(self) -> Any:
        """Return the rows as ``data_frame`` does."""
        return data_frame(self.rows)


def data_frame(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Return a data frame of pandas or, if it is not installed, Polars.

    Raises:
        FungraspError: neither is installed.
    """
    for name in ("pandas", "polars"):
        if find_spec(name) is not None:
            return import_module(name).DataFrame(rows)
    raise FungraspError("a frame needs pandas or Polars: pip install pandas")


def write_result(path: str | Path, header: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a header and its table, ``<name>.json`` and ``<name>.csv``.

    Args:
        path: path of the header, ends in ``.json``.
        header: JSON values without NaN and infinity.
        rows: rows, which may be nested and may lack columns.

    Raises:
        FungraspError: the suffix is wrong, a file can't be written, or a value is NaN or infinite.
    """
    path = check_suffix(path, "a result", ".json")
    flat = [dict(_flattened(row)) for row in rows]
    names = dict.fromkeys(name for row in flat for name in row)
    kinds = {name: _kind([row.get(name) for row in flat]) for name in names}
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(kinds)
    writer.writerows([_text(row.get(name), kind) for name, kind in kinds.items()] for row in flat)
    table = stream.getvalue().encode()
    about = {"rows": f"{path.stem}.csv", "columns": kinds, "sha256": hashlib.sha256(table).hexdigest()}
    try:
        entries = {**header, **about}.items()
        lines = [f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in entries]
    except (TypeError, ValueError) as error:
        raise FungraspError(f"cannot write {path}: {error}") from error
    with atomic_path(path.with_suffix(".csv")) as temporary:
        temporary.write_bytes(table)
    with atomic_path(path) as temporary:
        temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def save_result(path: str | Path, whole: Mapping[str, Any], compact: bool = False) -> None:
    """Write a result with rows as lists.

    Args:
        whole: JSON values without NaN and infinity.
        compact: write a header and a table (``write_result``) instead of one file.

    Raises:
        FungraspError: the suffix is wrong, or a file can't be written.
    """
    path = check_suffix(path, "a result", ".json")
    if compact:
        write_result(path, *split_rows(whole))
        return
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(whole, indent=1, allow_nan=False) + "\n")


def read_result(path: str | Path) -> ResultFile:
    """Read a header with its table, or a single JSON file written by ``--json``.

    Raises:
        FungraspError: a file can't be read, or the table has changed since the header was written.
    """
    path = Path(path)
    try:
        header = read_json(path, "result", LARGEST)
        if not isinstance(header, dict):
            raise ValueError("it is not a table")
        if not isinstance(header.get("columns"), dict):
            header, rows = split_rows(header)
            return ResultFile(header, rows)
        kinds, name, digest = header.pop("columns"), header.pop("rows"), header.pop("sha256")
        table = read_bytes(path.parent / Path(name).name, "table", LARGEST)
        if hashlib.sha256(table).hexdigest() != digest:
            raise ValueError(f"{name} has changed since it was written")
        lines = csv.DictReader(io.StringIO(table.decode(), newline=""))
        rows = [{key: _value(line[key], kind) for key, kind in kinds.items()} for line in lines]
    except FungraspError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, csv.Error) as error:
        raise FungraspError(f"the result {path} is damaged: {one_line(error)}") from error
    return ResultFile(header, rows)


def split_rows(whole: Mapping[str, Any]) -> tuple[dict[str, Any], list[Row]]:
    """Split a result with rows as lists into header and rows.

    Args:
        whole: content of a file written by ``fungrasp evaluate --json``.
    """
    header, found = _split(whole, ())
    parts = ["/".join(place) for place, rows in found for _ in rows]
    rows = [dict(_flattened(row)) for _, rows in found for row in rows]
    if len(set(parts)) > 1:
        rows = [{PART: part, **row} for part, row in zip(parts, rows, strict=True)]
    return header, rows


def _split(
    value: Mapping[str, Any], place: tuple[str, ...]
) -> tuple[dict[str, Any], list[tuple[tuple[str, ...], Sequence[Row]]]]:
    header: dict[str, Any] = {}
    found: list[tuple[tuple[str, ...], Sequence[Row]]] = []
    for key, item in value.items():
        if key in ROW_LISTS and isinstance(item, list):
            found.append((place, item))
        elif isinstance(item, Mapping):
            header[key], inner = _split(item, (*place, key))
            found += inner
        else:
            header[key] = item
    return header, found


def _flattened(row: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from _flattened(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _kind(values: Sequence[Any]) -> str:
    """Return the narrowest type that holds all values except None."""
    kinds = {type(value) for value in values if value is not None}
    # A carriage return would end a row of the table; JSON escapes it.
    if any(isinstance(value, str) and "\r" in value for value in values):
        return "json"
    for name, allowed in (("bool", {bool}), ("int", {int}), ("float", {int, float}), ("str", {str})):
        if kinds <= allowed:
            return name
    return "json"


def _text(value: Any, kind: str) -> str:
    if value is None:
        return ""
    return json.dumps(value, allow_nan=False) if kind == "json" else str(value)


def _value(text: str, kind: str) -> Any:
    if kind == "str":
        return text
    if not text:
        return None
    if kind == "bool":
        return {"True": True, "False": False}[text]
    return {"int": int, "float": float, "json": json.loads}[kind](text)
