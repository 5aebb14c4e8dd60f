"""Which plan to follow: candidates, simulated rollouts, search."""

from fungrasp.planning.selection.search import Feasible, SearchPlanner
from fungrasp.planning.selection.settings import SelectionSettings

__all__ = ["Feasible", "SearchPlanner", "SelectionSettings"]
