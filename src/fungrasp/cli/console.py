"""What several commands print: tables, progress bars; and the JSON files they write."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as lines, columns aligned: the first to the left, the others to the right."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def left_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as lines, all columns aligned to the left."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


@contextmanager
def progress_bar(words: str, total: float) -> Iterator[Callable[[float], None]]:
    """A bar on stderr while something takes long; nothing where stderr is no terminal.

    Args:
        words: what is being done.
        total: how much there is to do.

    Yields:
        A function to be called with how much is done.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(words, total=total)
        yield lambda done: bar.update(task, completed=done)


def write_json(path: Path, value: Any) -> None:
    """Whole or not at all; NaN is a bug.

    Raises:
        FungraspError: the file can't be written.
    """
    from fungrasp.files import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")
