"""Human grasps to robot grasps (paper IV.A), and the baselines."""

from fungrasp.retargeting.contact_optimization import RetargetSettings
from fungrasp.retargeting.retarget import METHODS, retarget
from fungrasp.retargeting.retargeter import FollowedPose, Retargeter, RetargeterSettings

__all__ = ["METHODS", "FollowedPose", "RetargetSettings", "Retargeter", "RetargeterSettings", "retarget"]
