"""The log of a bring-up: a Markdown page, a section for each step as it ends."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from time import strftime

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import one_line, read_bytes

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
"""How a step ends."""

TITLE = "# Bring-up of "
LARGEST = 4_000_000
"""Bytes of the largest log that is read."""

_SECTION = re.compile(r"^## (?P<step>[a-z-]+): (?P<status>passed|failed|skipped)$", re.MULTILINE)


@dataclass(frozen=True)
class StepResult:
    """How a step went."""

    status: str
    """PASSED, FAILED or SKIPPED."""
    measured: tuple[str, ...] = field(default=())
    """What was measured or said, a line each."""


class BringUpLog:
    """A log file, which is written whole after each step."""

    def __init__(self, path: str | Path, cell: str, digest: str):
        """
        Args:
            path: the file; one that is there goes on.
            cell: name of the cell.
            digest: of the cell and its hand.

        Raises:
            FungraspError: the file is no log, or one of another cell.
        """
        self._path, self._digest = Path(path), digest[:12]
        title = f"{TITLE}{cell}"
        if not self._path.exists():
            self._text = (
                f"{title}\n\nWritten by `fungrasp robots bring-up`, fungrasp {__version__}. Of each step the "
                "last section counts; the command goes on after the last one that did not fail.\n"
            )
            return
        self._text = read_bytes(self._path, "log of a bring-up", LARGEST).decode("utf-8", errors="replace")
        first = self._text.partition("\n")[0]
        if not first.startswith(TITLE):
            raise FungraspError(f"{path} is no log of a bring-up: give another name")
        if first != title:
            raise FungraspError(f"{path} is of the cell {first.removeprefix(TITLE)}, not {cell}")

    @property
    def done(self) -> dict[str, str]:
        """How each step ended, the last time."""
        return {found["step"]: found["status"] for found in _SECTION.finditer(self._text)}

    @property
    def other_cell(self) -> bool:
        """Whether steps were done before cell or hand were changed."""
        return bool(self.done) and f"cell {self._digest}" not in self._text.rpartition("\n## ")[2]

    def append(self, step: str, title: str, result: StepResult) -> None:
        """Write down how a step went.

        Args:
            step: its name.
            title: what it was, in words.
            result: how it went.

        Raises:
            FungraspError: the file can't be written.
        """
        lines = [one_line(line, 400) for line in result.measured]
        listed = "".join(f"- {line}\n" for line in lines)
        when = strftime("%Y-%m-%d %H:%M")
        self._text += f"\n## {step}: {result.status}\n\n{title} {when}, cell {self._digest}.\n\n{listed}"
        with atomic_path(self._path) as temporary:
            temporary.write_text(self._text, encoding="utf-8")
