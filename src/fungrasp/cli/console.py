"""What several commands print: tables, progress bars; and the files they write."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from fungrasp.text_table import table

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet

__all__ = ["option", "progress_bar", "suggest", "table", "write_human_grasps", "write_json"]

LINE_PERIOD = 30.0
"""Time between two lines of progress where there is no terminal [s]."""


def suggest(*words: object) -> None:
    """Say which command is useful next. words: of its command line; None and "" are left out."""
    print("next: fungrasp", *(word for word in words if word not in (None, "")))


def option(name: str, value: object) -> str:
    """An option of a command line with its value; "" where there is none. name: with its dashes."""
    return "" if value is None else f"{name} {value}"


@contextmanager
def progress_bar(words: str, total: float) -> Iterator[Callable[[float], None]]:
    """A bar on stderr while something takes long; where stderr is no terminal, a line now and then, and one
    at the end if there was any.

    Args:
        words: what is being done.
        total: how much there is to do.

    Yields:
        A function to be called with how much is done.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        lines = _PlainLines(words, total)
        yield lines.show
        lines.end()
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(words, total=total)
        yield lambda done: bar.update(task, completed=done)


class _PlainLines:
    """How much is done, printed on stderr: a line every ``LINE_PERIOD`` seconds."""

    def __init__(self, words: str, total: float):
        self._words, self._total = words, total
        self._last, self._shown = monotonic(), -1

    def show(self, done: float) -> None:
        if monotonic() - self._last >= LINE_PERIOD:
            self._last = monotonic()
            self._print(round(100 * done / self._total))

    def end(self) -> None:
        if self._shown not in (-1, 100):
            self._print(100)

    def _print(self, percent: int) -> None:
        self._shown = percent
        print(f"{self._words}: {percent} %", file=sys.stderr, flush=True)


def write_json(path: Path, value: Any) -> None:
    """Whole or not at all; NaN is a bug.

    Raises:
        FungraspError: the file can't be written.
    """
    from fungrasp.files import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")


def write_human_grasps(path: Path, grasps: HumanGraspSet) -> None:
    """Write a file, and print how many grasps it holds and what is unusual in them.

    Raises:
        FungraspError: it can't be written.
    """
    from fungrasp.grasps import save_human_grasps
    from fungrasp.grasps.anatomy import check_anatomy, grouped
    from fungrasp.grasps.diagnosis import table_remarks

    save_human_grasps(path, grasps)
    findings = check_anatomy(grasps)
    print(f"{path}: {len(grasps)} grasps of {len(set(grasps.object_name.tolist()))} objects")
    for remark in table_remarks(grasps.hand_joints):
        print(f"{remark}; 'fungrasp grasps convert --below-table lift' or 'drop' mends it")
    for finding in grouped(findings):
        print(f"unusual anatomy: {finding}")
