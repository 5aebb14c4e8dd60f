"""HumanGrasp -> RobotGrasp (paper IV.A)."""

from fungrasp.retarget.ours import RetargetSettings
from fungrasp.retarget.retarget import METHODS, load_objects, retarget

__all__ = ["METHODS", "RetargetSettings", "load_objects", "retarget"]
