"""A short run of ``fuzz``; ``make fuzz CASES=1000 SEED=1`` makes a long one."""

from __future__ import annotations

from pathlib import Path

import pytest
from foreign_files import KINDS
from fuzz import run_kind

CASES = 12


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_taken_or_refused_in_one_line(tmp_path: Path, kind: str):
    found: list[str] = []
    run_kind(kind, CASES, 0, tmp_path, lambda number, fault, path: found.append(f"case {number}: {fault}"))
    assert not found


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("label-pickle", "hand-estimate")])
def test_the_good_file_of_each_kind_is_taken(tmp_path: Path, kind: str):
    name, good, read = KINDS[kind](tmp_path)
    (tmp_path / name).write_bytes(good)
    read(tmp_path / name)
