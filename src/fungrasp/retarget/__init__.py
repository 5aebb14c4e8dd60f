"""Human grasps to robot grasps (paper IV.A), and the baselines."""

from fungrasp.retarget.contact_optimization import RetargetSettings
from fungrasp.retarget.retarget import METHODS, retarget
from fungrasp.retarget.retargeter import FollowedPose, Retargeter, RetargeterSettings

__all__ = ["METHODS", "FollowedPose", "RetargetSettings", "Retargeter", "RetargeterSettings", "retarget"]
