"""Selection of a plan: candidates, simulated rollouts, search."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.planning.selection.search import Feasible, SearchPlanner
    from fungrasp.planning.selection.settings import SelectionSettings

__all__ = ["Feasible", "SearchPlanner", "SelectionSettings"]

__getattr__ = lazy_names(__name__, {"search": "Feasible SearchPlanner", "settings": "SelectionSettings"})
