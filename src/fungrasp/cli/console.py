"""What several commands print: tables, progress bars; and the JSON files they write."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

LINE_PERIOD = 30.0
"""Time between two lines of progress where there is no terminal [s]."""

PIPE_WIDTH = 10_000
"""Width of a table that is not printed on a terminal [characters]."""


def table(
    rows: Sequence[Sequence[str]], left: Collection[int] | None = (0,), widest: int | None = None
) -> str:
    """Rows of cells as aligned lines; on a terminal, cells are folded so that the lines fit.

    Args:
        rows: the head first, all of the same length.
        left: columns that are aligned to the left, all if None; the others are aligned to the right.
        widest: a longer cell is folded, terminal or not [characters].
    """
    from io import StringIO

    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for column in range(len(rows[0])):
        to_the_left = left is None or column in left
        grid.add_column(justify="left" if to_the_left else "right", max_width=widest, overflow="fold")
    for row in rows:
        grid.add_row(*map(Text, row))
    stream = StringIO()
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else PIPE_WIDTH
    Console(file=stream, width=width, color_system=None).print(grid)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())


@contextmanager
def progress_bar(words: str, total: float) -> Iterator[Callable[[float], None]]:
    """A bar on stderr while something takes long; where stderr is no terminal, a line now and then.

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
        yield _plain_lines(words, total)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(words, total=total)
        yield lambda done: bar.update(task, completed=done)


def _plain_lines(words: str, total: float) -> Callable[[float], None]:
    """Prints how much is done on stderr, a line every ``LINE_PERIOD`` seconds."""
    last = monotonic()

    def show(done: float) -> None:
        nonlocal last
        if monotonic() - last >= LINE_PERIOD:
            last = monotonic()
            print(f"{words}: {100 * done / total:.0f} %", file=sys.stderr, flush=True)

    return show


def write_json(path: Path, value: Any) -> None:
    """Whole or not at all; NaN is a bug.

    Raises:
        FungraspError: the file can't be written.
    """
    from fungrasp.files import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")
