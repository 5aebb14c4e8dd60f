"""Every example runs, in a folder of its own."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

import fungrasp

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
SLOW = ("05_replay_without_simulation", "06_own_randomization", "08_perceive", "11_deploy_on_a_twin")
"""Take ten seconds and more on two busy cores."""


def test_examples_are_numbered() -> None:
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.slow if p.stem in SLOW else (), id=p.stem) for p in EXAMPLES],
)
def test_example_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        runpy.run_path(str(path), run_name="__main__")
    except SystemExit as end:
        assert str(end).startswith("skipped: "), end
        pytest.skip(str(end))


def test_every_name_that_the_package_offers_exists() -> None:
    names = [name for name in dir(fungrasp) if not name.startswith("_")]
    assert "evaluate" in names
    for name in names:
        assert getattr(fungrasp, name) is not None


def test_a_name_that_it_does_not_offer_is_an_error() -> None:
    with pytest.raises(AttributeError, match="evaluat"):
        fungrasp.evaluat  # noqa: B018


@pytest.mark.parametrize(
    ("name", "lines"), [("01_from_arrays", 6), ("02_plan_and_evaluate", 12), ("03_own_policy", 20)]
)
def test_first_examples_are_short(name: str, lines: int) -> None:
    (path,) = (path for path in EXAMPLES if path.stem == name)
    _, _, code = path.read_text().split('"""', 2)
    assert len([line for line in code.splitlines() if line.strip()]) <= lines
