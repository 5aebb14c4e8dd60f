"""Which plan to follow: candidates, a success predictor, simulated rollouts, search."""

from fungrasp.planning.selection.search import SearchPlanner, SelectionSettings

__all__ = ["SearchPlanner", "SelectionSettings"]
