"""What other packages bring by their entry points."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from fungrasp.core.errors import FungraspError, UnknownNameError


def load_plugin(group: str, kind: str, name: str) -> Any:
    """What an installed package brings.

    Args:
        group: of the entry points.
        kind: what it is, for messages.
        name: of the entry point.

    Raises:
        FungraspError: no installed package has it, or it can't be loaded.
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
