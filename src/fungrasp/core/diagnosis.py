"""What is installed and there: programs, extras, devices, caches. Nothing is opened, and no network asked."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from fungrasp.core.files import cache_path
from fungrasp.core.provenance import git_revision
from fungrasp.core.version import __version__

MAIN_PACKAGES = ("mujoco-core", "numpy", "scipy", "numba", "torch", "viser")
"""Whose versions explain most differences."""


@dataclass(frozen=True)
class ExtraState:
    """An optional extra."""

    name: str
    """As in ``pip install 'fungrasp[NAME]'``."""
    missing: tuple[str, ...]
    """What it needs and is not installed, or is too old or too new."""


@dataclass(frozen=True)
class CacheState:
    """A folder of things that can be made or fetched again."""

    what: str
    """That it holds."""
    path: str
    """Where it is."""
    exists: bool
    """Whether there is anything."""
    megabytes: float
    """Its size."""


@dataclass(frozen=True)
class Diagnosis:
    """What was found."""

    programs: tuple[tuple[str, str], ...]
    """Name and version."""
    extras: tuple[ExtraState, ...]
    """All of the package."""
    devices: tuple[tuple[str, str], ...]
    """Kind and what is there."""
    caches: tuple[CacheState, ...]
    """All of the package."""

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return asdict(self)


def diagnose() -> Diagnosis:
    """Look at what is installed and there."""
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
    """Requirements of an extra that are not met."""
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
    """Processors, graphics card, cameras, serial ports and CAN interfaces."""
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
    """Folders of things that can be made or fetched again."""
    root, found = cache_path("all").parent, []
    for path in sorted(root.glob("*")) if root.is_dir() else []:
        files = [file for file in path.rglob("*") if file.is_file()]
        size = sum(file.stat().st_size for file in files) / 1e6
        found.append(CacheState(path.name, str(path), bool(files), size))
    return found or [CacheState("all", str(root), False, 0.0)]
