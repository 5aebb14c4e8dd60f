"""Provenance of results, and the installation: programs, extras, devices, caches."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from fungrasp.core import __version__
from fungrasp.core.files import cache_path


def run_record(seed: int | list[int]) -> dict[str, Any]:
    """Return the provenance for result files: command, versions, seed, machine and date.

    Args:
        seed: seed or seeds of the run.
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
    """Return the provenance for pages: program, command, source, seed, machine and date as text.

    Args:
        source: inputs by kind.
        seconds: duration [s], if known.
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
    """Return the start of this process's command: ``fungrasp``, or ``python -m`` and a module."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return ["fungrasp"] if spec is None else ["python", "-m", spec.name.removesuffix(".__main__")]


def machine() -> str:
    """Return operating system, processors, and versions of Python and MuJoCo as text."""
    import mujoco

    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors, "
        f"Python {platform.python_version()}, MuJoCo {mujoco.__version__}"
    )


def git_revision() -> str:
    """Return the git commit of the checkout, with "+changes" if it was edited; "" outside a checkout."""

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


MAIN_PACKAGES = ("mujoco-core", "numpy", "scipy", "numba", "torch", "viser")
"""Packages whose versions explain most differences."""


@dataclass(frozen=True)
class ExtraState:
    """An optional extra."""

    name: str
    """Name, as in ``pip install 'fungrasp[NAME]'``."""
    missing: tuple[str, ...]
    """Requirements that are not installed or have a wrong version."""


@dataclass(frozen=True)
class CacheState:
    """A cache folder, whose content can be recreated."""

    what: str
    """Kind of content."""
    path: str
    """Path of the folder."""
    exists: bool
    """Whether the folder has files."""
    megabytes: float
    """Total size [MB]."""


@dataclass(frozen=True)
class Diagnosis:
    """State of the installation."""

    programs: tuple[tuple[str, str], ...]
    """Names and versions of programs."""
    extras: tuple[ExtraState, ...]
    """All extras of the package."""
    devices: tuple[tuple[str, str], ...]
    """Kinds and names of devices."""
    caches: tuple[CacheState, ...]
    """All caches of the package."""


def diagnose() -> Diagnosis:
    """Inspect the installation."""
    revision = git_revision()
    own = f"{__version__}, revision {revision[:12]}" if revision else __version__
    programs = [("fungrasp", own), ("Python", platform.python_version()), ("system", platform.platform())]
    programs += [(name, _version(name) or "not installed") for name in MAIN_PACKAGES]
    return Diagnosis(tuple(programs), tuple(_extras()), tuple(_devices()), tuple(_caches()))


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _extras() -> list[ExtraState]:
    try:
        known = importlib.metadata.metadata("fungrasp").get_all("Provides-Extra") or []
        needs = importlib.metadata.requires("fungrasp") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return [ExtraState(name, tuple(_missing(name, needs))) for name in known]


def _missing(extra: str, needs: list[str]) -> list[str]:
    """Return the unmet requirements of an extra."""
    from packaging.requirements import Requirement

    found: list[str] = []
    for requirement in map(Requirement, needs):
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}) or not marker.evaluate({"extra": extra}):
            continue
        if requirement.name == "fungrasp":
            for other in sorted(requirement.extras):
                found += _missing(other, needs)
            continue
        version = _version(requirement.name)
        if version is None:
            found.append(requirement.name)
        elif not requirement.specifier.contains(version, prereleases=True):
            found.append(f"{requirement.name}{requirement.specifier} (is {version})")
    return list(dict.fromkeys(found))


def _devices() -> list[tuple[str, str]]:
    """Return processors, graphics cards, cameras, serial ports and CAN interfaces."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    found = [("processors", str(usable))]
    cards = sorted(str(path) for path in Path("/dev").glob("nvidia[0-9]*"))
    found.append(("graphics cards", ", ".join(cards) or "none seen"))
    cameras = [_camera_name(path) for path in sorted(Path("/sys/class/video4linux").glob("video*"))]
    found.append(("cameras", ", ".join(cameras) or "none seen"))
    ports = sorted(str(path) for kind in ("ttyUSB*", "ttyACM*") for path in Path("/dev").glob(kind))
    found.append(("serial ports", ", ".join(ports) or "none seen"))
    net = Path("/sys/class/net")
    # Type 280 is ARPHRD_CAN.
    cans = [p.name for p in sorted(net.glob("*")) if _text(p / "type") == "280"]
    found.append(("CAN interfaces", ", ".join(cans) or "none seen"))
    return found


def _camera_name(path: Path) -> str:
    return f"{path.name} ({_text(path / 'name') or 'no name'})"


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def _caches() -> list[CacheState]:
    """Return all cache folders."""
    root, found = cache_path("all").parent, []
    for path in sorted(root.glob("*")) if root.is_dir() else []:
        files = [file for file in path.rglob("*") if file.is_file()]
        size = sum(file.stat().st_size for file in files) / 1e6
        found.append(CacheState(path.name, str(path), bool(files), size))
    return found or [CacheState("all", str(root), False, 0.0)]
