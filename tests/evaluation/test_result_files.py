"""Result files: what is written comes back, old single files are read alike, damage is found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.result_files import read_result, save_result, split_rows, write_result

HEADER = {"command": "fungrasp evaluate", "seed": 0, "success_rate": 0.5}
ROWS = [
    {"index": 0, "object": "a, b", "success": True, "slip": 1.5, "reason": "", "seconds": {"cpu": 1.0}},
    {"index": 1, "object": '"c"', "success": False, "slip": None, "reason": "lost", "seconds": {"cpu": 2}},
]
FLAT = [
    {"index": 0, "object": "a, b", "success": True, "slip": 1.5, "reason": "", "seconds.cpu": 1.0},
    {"index": 1, "object": '"c"', "success": False, "slip": None, "reason": "lost", "seconds.cpu": 2.0},
]


def test_header_and_rows_come_back(tmp_path: Path) -> None:
    write_result(tmp_path / "r.json", HEADER, ROWS)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.csv", "r.json"]
    result = read_result(tmp_path / "r.json")
    assert result.header == HEADER and result.rows == FLAT
    assert (tmp_path / "r.csv").read_text().splitlines()[0] == ",".join(FLAT[0])


VALUES = {
    "bool": st.booleans(),
    "int": st.integers(-(2**70), 2**70),
    "float": st.floats(allow_nan=False, allow_infinity=False),
    "str": st.text(st.characters(blacklist_categories=("Cs",))),
    "json": st.lists(st.integers(), max_size=3),
}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=50)
@given(rows=st.lists(st.fixed_dictionaries(VALUES), min_size=1, max_size=4))
def test_any_rows_come_back(tmp_path: Path, rows) -> None:
    write_result(tmp_path / "r.json", {}, rows)
    assert read_result(tmp_path / "r.json").rows == rows


def test_a_single_file_of_an_earlier_version_is_read_alike(tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    path.write_text(json.dumps({**HEADER, "trials": ROWS}))
    assert read_result(path).header == HEADER
    assert [row["seconds.cpu"] for row in read_result(path).rows] == [1.0, 2.0]


def test_rows_in_several_places_say_where_they_were() -> None:
    whole = {"trials": ROWS[:1], "robustness": {"mass x2": {"rate": 0.5, "trials": ROWS[1:]}}}
    header, rows = split_rows(whole)
    assert header == {"robustness": {"mass x2": {"rate": 0.5}}}
    assert [row["part"] for row in rows] == ["", "robustness/mass x2"]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("r.csv", lambda text: text.replace("lost", "held"), "r.csv has changed"),
        ("r.json", lambda text: text[:-5], "is damaged|is not valid JSON"),
        ("r.json", lambda text: "[]", "it is not a table"),
        ("r.json", lambda text: text.replace('"sha256"', '"sha"'), "is damaged|is not valid JSON"),
    ],
)
def test_damage_is_found(tmp_path: Path, name: str, change, message: str) -> None:
    write_result(tmp_path / "r.json", HEADER, ROWS)
    (tmp_path / name).write_text(change((tmp_path / name).read_text()))
    with pytest.raises(FungraspError, match=message):
        read_result(tmp_path / "r.json")


def test_what_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(FungraspError, match="does not exist"):
        read_result(tmp_path / "none.json")
    with pytest.raises(FungraspError, match=r"a result is a \.json file, not .*r\.csv"):
        save_result(tmp_path / "r.csv", {})
    with pytest.raises(FungraspError, match="cannot write"):
        write_result(tmp_path / "r.json", {"rate": float("nan")}, ROWS)
    assert list(tmp_path.iterdir()) == []
