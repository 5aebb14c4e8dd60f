"""Drivers by name: this package's own, and those that other installed packages bring by entry points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.robots.cell import RobotCell

OWN = "fungrasp"
"""Name of the distribution that this package's own drivers come from."""


@dataclass(frozen=True)
class DriverRegistry:
    """Drivers of one kind of device. A driver is a callable that makes a device from a cell."""

    what: str
    """The device, as in a cell's file: "arm", "hand_device" or "tracker"."""
    group: str
    """Group of the entry points."""
    own: Mapping[str, Callable[[RobotCell], Any]]
    """This package's, by name."""
    twin: str
    """Name that stands for a device of a twin, which nobody else's may have."""
    protocol: type
    """What a driver makes: ``JointDriver`` or ``PoseSource``."""

    def known(self) -> dict[str, str]:
        """Distribution of each driver by name; several, with commas, where their names clash."""
        found = dict.fromkeys((*self.own, self.twin), OWN)
        for entry in entry_points(group=self.group):
            origin = _distribution(entry)
            found[entry.name] = f"{found[entry.name]}, {origin}" if entry.name in found else origin
        return dict(sorted(found.items()))

    def make(self, name: str, cell: RobotCell) -> Any:
        """The device of a cell.

        Args:
            name: of the driver.
            cell: the robot.

        Raises:
            FungraspError: no driver has this name, several have, or it can't be loaded or used; the message
                names the distribution.
        """
        entries = [entry for entry in entry_points(group=self.group) if entry.name == name]
        if len(entries) + (name in (*self.own, self.twin)) > 1:
            raise FungraspError(
                f"'{self.what}.driver': '{name}' is brought by several packages, {self.known()[name]}: "
                "uninstall all but one"
            )
        if name not in self.own and not entries:
            error = UnknownNameError("driver", name, self.known())
            raise FungraspError(f"'{self.what}.driver': {error}")
        try:
            return self.own[name](cell) if name in self.own else self._make_of_others(entries[0], cell)
        except FungraspError as error:
            raise FungraspError(f"[{self.what}] {error}") from error

    def _make_of_others(self, entry: EntryPoint, cell: RobotCell) -> Any:
        origin = f"the driver '{entry.name}' of the package {_distribution(entry)}"
        try:
            driver = entry.load()
        except Exception as error:
            # Whatever a module of others does when it is imported.
            raise FungraspError(f"{origin} can't be loaded: {_line(error)}") from error
        try:
            device = driver(cell)
        except FungraspError:
            raise
        except Exception as error:
            raise FungraspError(f"{origin} can't be made from cell '{cell.name}': {_line(error)}") from error
        missing = [name for name in _members(self.protocol) if not hasattr(device, name)]
        if missing:
            raise FungraspError(f"{origin} is no {self.protocol.__name__}: it has no '{missing[0]}'")
        return device


def _members(protocol: type) -> list[str]:
    names = [name for name in vars(protocol) if not name.startswith("_")]
    return [*protocol.__annotations__, *names]


def _distribution(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else entry.value


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
