"""Plugins from entry points of other packages."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from fungrasp.core.errors import FungraspError, UnknownNameError


def load_plugin(group: str, kind: str, name: str) -> Any:
    """Load an entry point of an installed package.

    Args:
        group: group of the entry point.
        kind: kind of plugin, for messages.
        name: name of the entry point.

    Raises:
        FungraspError: no installed package has the entry point, or it can't be loaded.
    """
    found = {entry.name: entry for entry in entry_points(group=group)}
    if not found:
        raise FungraspError(f"no {kind} '{name}': no installed package brings any (entry point {group})")
    if name not in found:
        raise UnknownNameError(kind, name, found)
    try:
        return found[name].load()
    except ImportError as error:
        raise FungraspError(f"the {kind} '{name}' can't be loaded: {' '.join(str(error).split())}") from error
