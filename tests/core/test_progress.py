"""Progress is shown where somebody looks: in terminals and notebooks, or where it is asked for."""

from __future__ import annotations

import sys
import threading

import pytest

from fungrasp.core import progress
from fungrasp.core.progress import progress_bar, shown_progress


def test_progress_off_a_terminal_is_a_line_now_and_then(capsys, monkeypatch):
    now = iter([0.0, 10.0, 31.0, 31.0, 40.0])
    monkeypatch.setattr(progress, "monotonic", lambda: next(now))
    with progress_bar("lifting", 8) as show:
        for done in (1, 4, 5):
            show(done)
    assert capsys.readouterr().err == "lifting: 50 %\nlifting: 100 %\n"


@pytest.mark.parametrize("how", [None, False])
def test_nothing_is_printed_into_files_unless_asked(how, capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_PERIOD", 0.0)
    with shown_progress(how, "lifting", 8) as show:
        show(4)
    assert capsys.readouterr() == ("", "")


def test_a_terminal_has_one_bar(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert progress._watched()
    with progress._bars:
        assert not progress._watched()
        with progress_bar("inner", 1) as show:
            show(1)
    seen: list[bool] = []
    thread = threading.Thread(target=lambda: seen.append(progress._watched()))
    thread.start()
    thread.join()
    assert seen == [False]


def test_a_function_of_ones_own_is_called():
    seen: list[float] = []
    with shown_progress(seen.append, "lifting", 8) as show:
        show(3.0)
    assert seen == [3.0]
