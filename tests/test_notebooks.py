"""The numbered notebooks run, cell by cell; and what notebooks show of grasps, plans and results."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import fungrasp
from fungrasp.core.text_table import table
from fungrasp.evaluation import read_result
from fungrasp.media.grasp_pages import notebook_html

NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples" / "notebooks").glob("*.ipynb"))


def test_notebooks_are_numbered() -> None:
    assert [int(path.name[0]) for path in NOTEBOOKS] == [1, 2, 3]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if path.name.startswith("3"):
        pytest.importorskip("gymnasium", reason="the extra gymnasium is not installed")
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "__main__"}
    cells = json.loads(path.read_text())["cells"]
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), names)
            assert not cell["outputs"], "outputs are not kept in the repository"


def test_pages_of_the_manual_are_of_these_notebooks() -> None:
    """``python -m benchmarks.documents.notebooks`` makes them anew."""
    pages = Path(__file__).parents[1] / "docs" / "notebooks"
    assert sorted(page.name for page in pages.iterdir()) == [path.stem for path in NOTEBOOKS]
    for path in NOTEBOOKS:
        page = (pages / path.stem / "index.md").read_text()
        for cell in json.loads(path.read_text())["cells"]:
            assert "".join(cell["source"]).strip() in page, path.name


def test_a_table_does_not_show_itself_in_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list = []
    display = SimpleNamespace(display=lambda *what, **how: shown.append(what))
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert table([("a", "b"), ("1", "2")]) and not shown


def test_grasps_plans_and_results_show_themselves() -> None:
    human = fungrasp.builtin_grasps()[:1]
    objects = fungrasp.load_objects(human)
    robot = fungrasp.retarget(human, objects, "inspire")
    name = str(human.object_name[0])
    for grasps in (human, robot):
        html = notebook_html(grasps)
        assert html and "data:image/png;base64," in html and f"<td>{name}</td>" in html
    plans = notebook_html(fungrasp.plan(robot, objects))
    assert plans and "lifts at" in plans and f"<td>{name}</td>" in plans
    result = notebook_html(fungrasp.evaluate(robot, objects))
    assert result and "<svg" in result and "mean over objects" in result
    assert notebook_html(3) is None


def test_jupyter_is_told_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    told = {}
    html = SimpleNamespace(for_type_by_name=lambda module, name, show: told.update({(module, name): show}))
    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"text/html": html}))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    fungrasp._tell_notebooks()
    human = fungrasp.builtin_grasps()[:1]
    show = told[(type(human).__module__, type(human).__name__)]
    assert "data:image/png" in show(human)
    for module, name in told:
        assert hasattr(sys.modules.get(module) or __import__(module, fromlist=[name]), name)


def test_a_frame_has_a_row_for_each_episode(tmp_path) -> None:
    pandas = pytest.importorskip("pandas", reason="neither pandas nor Polars is installed")
    human = fungrasp.builtin_grasps()[:2]
    objects = fungrasp.load_objects(human)
    result = fungrasp.evaluate(fungrasp.retarget(human, objects, "inspire"), objects)
    result.save(tmp_path / "r.json")
    for frame in (result.frame(), read_result(tmp_path / "r.json").frame()):
        assert isinstance(frame, pandas.DataFrame) and len(frame) == 2
        assert {"object", "success", "reason", "seed"} <= set(frame.columns)
