"""The tables of README and docs say what the files in lab/results say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.documents import tables
from fungrasp.evaluation.result_files import read_result

ROOT = Path(__file__).parents[3]
RESULTS = sorted((ROOT / "lab" / "results").glob("*.json"))


def test_pages_agree_with_the_results() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.documents.tables", "--check"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_a_page_that_differs_is_found_and_mended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    page.write_text("<!-- table: hands -->\n| 99.9 % |\n<!-- end of table -->\nAnd on.\n")
    monkeypatch.setattr(tables, "PAGES", [page])
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    assert tables.main(["--check"]) == 1 and "99.9" in page.read_text()
    assert tables.main([]) == 0 and tables.main(["--check"]) == 0
    text = page.read_text()
    assert "| Allegro | 96.8 % |" in text and "99.9" not in text and text.endswith("And on.\n")
    assert "Measured by `fungrasp evaluate" in text and "hand-allegro.json" in text


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_every_result_says_how_it_came_about(path: Path) -> None:
    result = read_result(path)
    assert result.rows and "command" in result.header
    assert result.header.get("revision") or result.header["committed"]["revision"]
    for row in result.rows:
        assert not any(re.search(r"/(home|root|work|tmp)/", str(value)) for value in row.values())


def test_summaries_agree_with_the_episodes() -> None:
    compared = 0
    for path in RESULTS:
        result = read_result(path)
        rows = [row for row in result.rows if not row.get("part")]
        if "success_rate" in result.header and rows and "success" in rows[0]:
            compared += 1
            rate = sum(row["success"] for row in rows) / len(rows)
            assert rate == pytest.approx(result.header["success_rate"], rel=1e-5), path.name
    assert compared >= 15
