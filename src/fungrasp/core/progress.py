"""Progress of long work: bars in terminals and notebooks, text lines elsewhere."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TypeAlias

LINE_PERIOD = 30.0
"""Period of progress lines without a terminal [s]."""

ShowProgress: TypeAlias = "Callable[[float], None] | bool | None"
"""Progress of a function: a function called with the finished amount, a bar (True), nothing (False), or a bar
only in terminals and notebooks (None)."""

_bars = threading.Lock()
"""Held by the displayed bar, so that nested verbs show none."""


@contextmanager
def shown_progress(how: ShowProgress, words: str, total: float) -> Iterator[Callable[[float], None]]:
    """Yield a function that reports the finished amount, displayed as the caller requested.

    Args:
        words: label of the bar.
        total: total amount.
    """
    if callable(how):
        yield how
    elif how or (how is None and _watched()):
        with progress_bar(words, total) as show:
            yield show
    else:
        yield lambda done: None


def _watched() -> bool:
    """Return whether a bar of this thread would be visible."""
    if threading.current_thread() is not threading.main_thread() or _bars.locked():
        return False
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def progress_bar(words: str, total: float) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on stderr. If stderr is not a terminal, print periodic lines and one at the end.

    Args:
        total: total amount.

    Yields:
        a function that reports the finished amount.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if _bars.locked():
        # A terminal can show only one bar.
        yield lambda done: None
        return
    if not (console.is_terminal or console.is_jupyter):
        with _plain_lines(words, total) as show:
            yield show
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with _bars, Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(words, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def _plain_lines(words: str, total: float) -> Iterator[Callable[[float], None]]:
    """Report progress without a terminal: a line every ``LINE_PERIOD`` seconds."""
    last, shown = monotonic(), 100

    def line(percent: int) -> None:
        nonlocal shown
        shown = percent
        sys.stderr.write(f"{words}: {percent} %\n")
        sys.stderr.flush()

    def show(done: float) -> None:
        nonlocal last
        if monotonic() - last >= LINE_PERIOD:
            last = monotonic()
            line(round(100 * done / total))

    yield show
    if shown != 100:
        line(100)
