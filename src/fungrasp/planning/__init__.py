"""Robot grasps become grasp plans: settle, approach, grip, lift; and which of many plans to follow."""

from fungrasp.planning.grasp_motion import MotionPlanner, MotionSettings
from fungrasp.planning.plan import make_planner, plan
from fungrasp.planning.planner import ConstrainedPlanner, Planner

__all__ = ["ConstrainedPlanner", "MotionPlanner", "MotionSettings", "Planner", "make_planner", "plan"]
