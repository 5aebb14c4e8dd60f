"""Reading other people's data sets as human grasps; importers of other packages: entry point "
"``fungrasp.grasps``."""

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.grasps.human_grasp import HumanGraspSet

Importer = Callable[[Path], HumanGraspSet]
"""Takes the data set's file or folder."""


def load_importer(name: str) -> Importer:
    """An importer by the name of its entry point.

    Raises:
        FungraspError: no installed package has it.
    """
    found = {entry.name: entry for entry in entry_points(group="fungrasp.grasps")}
    if not found:
        raise FungraspError(f"no importer '{name}': no installed package brings importers of grasps")
    if name not in found:
        raise UnknownNameError("importer", name, found)
    return found[name].load()
