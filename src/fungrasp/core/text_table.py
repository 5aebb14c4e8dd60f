"""Text tables."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Collection, Sequence

PIPE_WIDTH = 10_000
"""Width of tables outside a terminal [characters]."""


def table(
    rows: Sequence[Sequence[str]], left: Collection[int] | None = (0,), widest: int | None = None
) -> str:
    """Format rows of cells as aligned lines. On a terminal, cells are folded to its width.

    Args:
        rows: rows of equal length, starting with the header.
        left: left-aligned columns, all if None; other columns are right-aligned.
        widest: width beyond which cells are always folded [characters].
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
    # In a notebook, rich would display the table instead of writing it.
    Console(file=stream, width=width, color_system=None, force_jupyter=False).print(grid)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())
