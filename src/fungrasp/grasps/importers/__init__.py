"""Reading other people's data sets as human grasps, and finding importers of other packages by name."""

from fungrasp.grasps.importers.dexycb import DexYCBOptions, import_dexycb
from fungrasp.grasps.importers.dgrasp import import_dgrasp
from fungrasp.grasps.importers.registry import load_importer

__all__ = ["DexYCBOptions", "import_dexycb", "import_dgrasp", "load_importer"]
