"""Plans from robot grasps (adapt, approach, close, squeeze, lift), and selection among plans."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.planning.grasp_motion import MotionPlanner, MotionSettings
    from fungrasp.planning.make_plans import make_planner, plan
    from fungrasp.planning.planner import ConstrainedPlanner, Planner

__all__ = ["ConstrainedPlanner", "MotionPlanner", "MotionSettings", "Planner", "make_planner", "plan"]

__getattr__ = lazy_names(
    __name__,
    {
        "grasp_motion": "MotionPlanner MotionSettings",
        "make_plans": "make_planner plan",
        "planner": "ConstrainedPlanner Planner",
    },
)
