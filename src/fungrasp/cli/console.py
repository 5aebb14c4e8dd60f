"""What commands answer and print: answers, tables, progress bars; and the files they write."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.progress import progress_bar
from fungrasp.core.text_table import table

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet

__all__ = [
    "Answering",
    "CommandResult",
    "option",
    "progress_bar",
    "suggestion",
    "table",
    "write_human_grasps",
    "write_json",
]

STDOUT = "-"
"""What ``--json`` means without a file, where it takes one."""


@dataclass(frozen=True)
class CommandResult:
    """What a command has found or made: for a program as JSON, for a person as text."""

    value: Any
    """Of JSON's kinds, NumPy's and paths; NaN and infinities become null."""
    text: str = ""
    """What a person reads in its place; "" where everything has been printed."""
    fault: str = ""
    """What is wrong though there is an answer; it becomes the error of the command."""
    status: int = 0
    """Exit status, where there is no fault."""

    def show(self, as_json: bool) -> None:
        """Print it.

        Raises:
            FungraspError: there is a fault.
            SystemExit: the status is not 0.
        """
        from fungrasp.core.formats.text_files import finite

        if as_json:
            print(json.dumps(finite(self.value), indent=2, allow_nan=False))
        elif self.text:
            print(self.text)
        if self.fault:
            raise FungraspError(self.fault)
        if self.status:
            raise SystemExit(self.status)


@dataclass(frozen=True, kw_only=True)
class Answering:
    """A command that answers: its method ``run`` returns an ``CommandResult``. While it runs with ``--json``,
    everything that is printed goes to stderr."""

    json: bool = False
    """Print the answer as JSON, and nothing else on stdout."""

    def run(self) -> CommandResult:
        """Do it."""
        raise NotImplementedError


def suggestion(*words: object) -> str:
    """A line that says which command is useful next. words: of its command line, paths as such; None and ""
    are left out."""
    given = (shlex.quote(str(word)) if isinstance(word, Path) else str(word) for word in words if word)
    return " ".join(("next: fungrasp", *given))


def option(name: str, value: object) -> str:
    """An option of a command line with its value; "" where there is none. name: with its dashes."""
    return "" if value is None else f"{name} {shlex.quote(str(value))}"


def write_json(path: Path, value: Any) -> None:
    """Whole or not at all; NaN is a bug.

    Raises:
        FungraspError: the file can't be written.
    """
    from fungrasp.core.files import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")


def write_human_grasps(path: Path, grasps: HumanGraspSet) -> CommandResult:
    """Write a file, and say how many grasps it holds and what is unusual in them.

    Raises:
        FungraspError: it can't be written.
    """
    from fungrasp.grasps import save_human_grasps
    from fungrasp.grasps.anatomy import check_anatomy, grouped
    from fungrasp.grasps.diagnosis import table_remarks

    save_human_grasps(path, grasps)
    objects, unusual = sorted(set(grasps.object_name.tolist())), grouped(check_anatomy(grasps))
    below = [str(remark) for remark in table_remarks(grasps.hand_joints)]
    lines = [f"{path}: {len(grasps)} grasps of {len(objects)} objects"]
    for remark in below:
        lines.append(f"{remark}; 'fungrasp grasps convert --below-table lift' or 'drop' mends it")
    lines += [f"unusual anatomy: {finding}" for finding in unusual]
    value = {
        "grasps": path,
        "count": len(grasps),
        "objects": objects,
        "below_table": below,
        "unusual_anatomy": unusual,
    }
    return CommandResult(value, "\n".join(lines))
