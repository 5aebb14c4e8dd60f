"""Where a result comes from: program, revision, command, machine."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from fungrasp.core.version import __version__


def run_record(seed: int | list[int]) -> dict[str, Any]:
    """What a result file says about the run that wrote it: command, versions, seed, machine and date.

    Args:
        seed: of the run, or its seeds.
    """
    import mujoco

    return {
        "command": shlex.join([*_program(), *sys.argv[1:]]),
        "version": __version__,
        "revision": git_revision(),
        "mujoco": mujoco.__version__,
        "seed": seed,
        "machine": machine(),
        "date": f"{datetime.now().astimezone():%Y-%m-%dT%H:%M%z}",
    }


def page_provenance(source: Mapping[str, str], seed: int, seconds: float | None = None) -> dict[str, str]:
    """Program, command, source, seed, machine and date, for people.

    Args:
        source: what it was made from, by what kind of thing that is.
        seed: of the command.
        seconds: how long it took [s], if known.
    """
    record = run_record(seed)
    revision = f", revision {record['revision'][:12]}" if record["revision"] else ""
    took = "" if seconds is None else f", made in {seconds:.0f} s"
    return {
        "Made by": f"fungrasp {record['version']}{revision}",
        "Command": record["command"],
        **source,
        "Seed": str(seed),
        "Machine": record["machine"],
        "Date": f"{record['date']}{took}",
    }


def _program() -> list[str]:
    """How this process was started: ``fungrasp``, or ``python -m`` and a module."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return ["fungrasp"] if spec is None else ["python", "-m", spec.name.removesuffix(".__main__")]


def machine() -> str:
    """Operating system, processors, and the versions of Python and MuJoCo, in words."""
    import mujoco

    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors, "
        f"Python {platform.python_version()}, MuJoCo {mujoco.__version__}"
    )


def git_revision() -> str:
    """The commit of the checkout that fungrasp runs from, "+changes" if it was edited since; "" if there is
    none."""

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(Path(__file__).parent), *arguments],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "__init__.py")
        return git("rev-parse", "HEAD") + ("+changes" if git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.SubprocessError):
        return ""
