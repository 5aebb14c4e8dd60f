"""Human grasps to robot grasps (paper IV.A), and the baselines."""

from fungrasp.retarget.contact_optimization import RetargetSettings
from fungrasp.retarget.retarget import METHODS, retarget

__all__ = ["METHODS", "RetargetSettings", "retarget"]
