"""Records as JSON and back: nothing is lost, and what is wrong is named."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.planning.selection import SelectionSettings
from fungrasp.sim2real import PRESETS, Randomization


@dataclass(frozen=True)
class Inner:
    pair: tuple[float, int] = (1.0, 2)


@dataclass(frozen=True)
class Outer:
    name: str
    kind: Literal["a", "b"] = "a"
    rows: tuple[int, ...] = ()
    inner: Inner = field(default_factory=Inner)
    maybe: Inner | None = None
    file: Path | None = None
    factor: float = 1.0
    by_name: Mapping[str, float] = field(default_factory=dict)
    flag: bool = False


def back(record):
    return record_from_json(type(record), json.loads(json.dumps(record_to_json(record))), "record")


def test_there_and_back():
    one = Outer("x", "b", (1, 2), Inner((0.5, 3)), Inner(), Path("a/b"), 3, {"k": 2.5}, True)
    assert back(one) == one
    assert back(Outer("x")) == Outer("x")
    assert record_from_json(Outer, {"name": "y"}, "record") == Outer("y")


@pytest.mark.parametrize("name", PRESETS)
def test_settings_there_and_back(name):
    assert back(PRESETS[name]) == PRESETS[name]
    assert back(SelectionSettings.for_protocol("reality")) == SelectionSettings.for_protocol("reality")
    assert back(Randomization()) == Randomization()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([], "r: expected the fields of a Outer, not []"),
        ({}, "r: missing 1 required positional argument: 'name'"),
        ({"name": "x", "knd": "a"}, "r: there is no field 'knd'; did you mean 'kind'?"),
        ({"name": 3}, "r: name: expected text, not 3"),
        ({"name": "x", "kind": "c"}, "r: kind: expected 'a' or 'b', not 'c'"),
        ({"name": "x", "rows": [1, 2.5]}, "r: rows[1]: expected a whole number, not 2.5"),
        ({"name": "x", "rows": 1}, "r: rows: expected a list, not 1"),
        ({"name": "x", "rows": [True]}, "r: rows[0]: expected a whole number, not True"),
        ({"name": "x", "inner": {"pair": [1]}}, "r: inner: pair: expected a list of 2, not of 1"),
        ({"name": "x", "maybe": 1}, "r: maybe: expected the fields of a Inner, not 1"),
        ({"name": "x", "factor": "2"}, "r: factor: expected a number, not '2'"),
        ({"name": "x", "by_name": {"k": None}}, "r: by_name.k: expected a number, not None"),
        ({"name": "x", "flag": 1}, "r: flag: expected true or false, not 1"),
    ],
)
def test_what_is_wrong_is_named(data, words):
    with pytest.raises(FungraspError) as error:
        record_from_json(Outer, data, "r")
    assert str(error.value) == words


def test_what_json_can_not_hold():
    with pytest.raises(FungraspError, match="nan"):
        record_to_json(Outer("x", factor=float("nan")))
    with pytest.raises(FungraspError, match="a set can't be written"):
        record_to_json({"a": {1}})
