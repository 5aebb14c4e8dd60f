"""Output of commands: results, tables, progress bars and files."""

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

LOW_CONFIDENCE = 3
"""Exit status if the confidence in a perceived grasp is low."""

STDOUT = "-"
"""Value of ``--json`` without a file, for commands with ``--json FILE``."""


@dataclass(frozen=True)
class CommandResult:
    """Result of a command, as JSON for programs and as text for people."""

    value: Any
    """JSON values, NumPy arrays or paths; NaN and infinities become null."""
    text: str = ""
    """Result for people; "" if everything has been printed."""
    fault: str = ""
    """Error message of a failed command with a result."""
    status: int = 0
    """Exit status if there is no fault."""

    def show(self, as_json: bool) -> None:
        """Print the result.

        Raises:
            FungraspError: the result has a fault.
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
    """A command whose method ``run`` returns a ``CommandResult``. With ``--json``, other output goes to
    stderr."""

    json: bool = False
    """Print the result as JSON, and nothing else on stdout."""

    def run(self) -> CommandResult:
        """Run the command."""
        raise NotImplementedError


def suggestion(*words: object) -> str:
    """Return a line with the next command. words: its arguments, paths as Path; None and "" are ignored."""
    given = (shlex.quote(str(word)) if isinstance(word, Path) else str(word) for word in words if word)
    return " ".join(("next: fungrasp", *given))


def option(name: str, value: object) -> str:
    """Return an option with its value; "" for None. name: name with dashes."""
    return "" if value is None else f"{name} {shlex.quote(str(value))}"


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file atomically. Values must be finite.

    Raises:
        FungraspError: the file cannot be written.
    """
    from fungrasp.core.files import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")


def write_human_grasps(path: Path, grasps: HumanGraspSet) -> CommandResult:
    """Write a grasp file, and report the number of grasps and their anomalies.

    Raises:
        FungraspError: the file cannot be written.
    """
    from fungrasp.grasps import save_human_grasps
    from fungrasp.grasps.anatomy import check_anatomy, grouped
    from fungrasp.grasps.diagnosis import table_remarks

    save_human_grasps(path, grasps)
    objects, unusual = sorted(set(grasps.object_name.tolist())), grouped(check_anatomy(grasps))
    below = [str(remark) for remark in table_remarks(grasps.hand_joints)]
    lines = [f"{path}: {len(grasps)} grasps of {len(objects)} objects", *below]
    lines += [f"unusual anatomy: {finding}" for finding in unusual]
    value = {
        "grasps": path,
        "count": len(grasps),
        "objects": objects,
        "below_table": below,
        "unusual_anatomy": unusual,
    }
    return CommandResult(value, "\n".join(lines))
