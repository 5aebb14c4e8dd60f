"""Tables on a terminal and in a pipe."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from fungrasp.cli.console import option, suggestion, table

ROWS = [("name", "slip [mm/s]"), ("  a", "1.5"), ("[b]", "95 % interval")]


def test_columns_are_aligned() -> None:
    assert table(ROWS).splitlines() == [
        "name    slip [mm/s]",
        "  a             1.5",
        "[b]   95 % interval",
    ]
    assert table(ROWS, left=None).splitlines()[1] == "  a   1.5"


def test_long_lines_are_folded_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [("name", "data"), ("a", "some words " * 20)]
    assert len(table(rows).splitlines()) == 2
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("shutil.get_terminal_size", lambda: os.terminal_size((40, 24)))
    lines = table(rows, left=None).splitlines()
    assert len(lines) > 5 and max(map(len, lines)) <= 40


def test_long_cells_are_folded_where_asked() -> None:
    lines = table([("name", "data"), ("a", "one two three")], left=None, widest=8).splitlines()
    assert lines == ["name  data", "a     one two", "      three"]


def test_a_suggested_command_can_be_copied_whatever_its_paths() -> None:
    line = suggestion("view", Path("my grasps.npz"), option("--objects", Path("a b")), option("--x", None))
    assert line == "next: fungrasp view 'my grasps.npz' --objects 'a b'"
