"""The first commands of a newcomer, from nothing: a clone and ``make demo``, a wheel and ``fungrasp demo``.

    python3 benchmarks/cold_start.py [clone] [wheel]

Needs Python 3.11, make and git alone: nothing of the project, and nothing that it depends on, is imported
here. Each way runs in a temporary folder with a home, a cache and a virtual environment of its own. It fails
where a command fails, where a film or a page is missing, and where a progress bar passes 100 %.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]

SHORTEST_FILM = 50_000
"""Bytes of a film with less in it than one grasp."""

INSTALLED = ".venv/.installed"
"""Target of the Makefile that makes the environment."""


class ColdStartError(Exception):
    """A command of a newcomer has failed."""


def main() -> int:
    parser = argparse.ArgumentParser(description="Try a newcomer's first commands in empty environments.")
    parser.add_argument("ways", nargs="*", help='"clone", "wheel"; both by default')
    arguments = parser.parse_args()
    ways = {"clone": from_clone, "wheel": from_wheel}
    if unknown := set(arguments.ways) - set(ways):
        parser.error(f"unknown way: {', '.join(sorted(unknown))}")
    for way in arguments.ways or ways:
        with tempfile.TemporaryDirectory(prefix="fungrasp-cold-start.") as name:
            try:
                seconds = ways[way](Path(name))
            except ColdStartError as error:
                print(f"cold start from a {way} failed: {error}", file=sys.stderr)
                return 1
        total = sum(seconds[phase] for phase in ("install", "demo"))
        words = ", ".join(f"{phase} {value:.0f} s" for phase, value in seconds.items())
        print(f"cold start from a {way}: {total:.0f} s ({words})", flush=True)
    return 0


def from_clone(folder: Path) -> dict[str, float]:
    """``git clone`` and ``make demo``. folder: an empty one; returns seconds by phase."""
    clone, environment = folder / "clone", _environment(folder)
    _run(["git", "clone", "--quiet", str(ROOT), str(clone)], folder, environment)
    seconds = {"install": _run(["make", INSTALLED], clone, environment)}
    seconds["demo"] = _run(["make", "demo"], clone, environment)
    _check_page(clone / "demo")
    if "seen in one image" not in (clone / "demo" / "index.html").read_text(encoding="utf-8"):
        print("the grasp in an image was left out: the hand models could not be fetched")
    return seconds


def from_wheel(folder: Path) -> dict[str, float]:
    """``pip install`` of a wheel and ``fungrasp demo``. folder: an empty one; returns seconds by phase."""
    environment, python = _environment(folder), folder / "venv" / "bin" / "python"
    _run([sys.executable, "-m", "venv", str(folder / "venv")], folder, environment)
    _run(
        [str(python), "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", "dist", str(ROOT)],
        folder,
        environment,
    )
    (wheel,) = (folder / "dist").glob("*.whl")
    seconds = {
        "install": _run([str(python), "-m", "pip", "install", "--quiet", str(wheel)], folder, environment)
    }
    command = [str(python.with_name("fungrasp")), "demo"]
    seconds["demo"] = _run(command, folder, environment)
    _check_page(folder / "demo")
    return seconds


def _environment(folder: Path) -> dict[str, str]:
    """Variables of a process whose home is empty; what says where packages come from is kept."""
    (folder / "home").mkdir()
    (folder / "cache").mkdir()
    hidden = ("PYTHONPATH", "VIRTUAL_ENV", "FUNGRASP")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
    return kept | {"HOME": str(folder / "home"), "XDG_CACHE_HOME": str(folder / "cache")}


def _run(command: list[str], folder: Path, environment: dict[str, str]) -> float:
    """Run a command. Returns its seconds.

    Raises:
        ColdStartError: it fails, or its progress does not end at 100 %.
    """
    start = perf_counter()
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    seconds = perf_counter() - start
    shown = [int(number) for number in re.findall(r"(\d+) %", done.stdout)]
    if done.returncode:
        raise ColdStartError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout[-4000:]}")
    if any(number > 100 for number in shown):
        raise ColdStartError(f"{' '.join(command)}: progress reached {max(shown)} %")
    return seconds


def _check_page(folder: Path) -> None:
    film, page = folder / "film.mp4", folder / "index.html"
    if not film.is_file() or film.stat().st_size < SHORTEST_FILM:
        raise ColdStartError(f"there is no film in {folder}")
    if not page.is_file() or "<video" not in page.read_text(encoding="utf-8"):
        raise ColdStartError(f"there is no page with films in {folder}")


if __name__ == "__main__":
    sys.exit(main())
