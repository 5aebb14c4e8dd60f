"""Human grasps to robot grasps (paper IV.A), and the baselines."""

from fungrasp.retargeting.contact_optimization import RetargetSettings
from fungrasp.retargeting.retarget import METHODS, RetargetSpec, method_name, retarget
from fungrasp.retargeting.retargeter import FollowedPose, Retargeter, RetargeterSettings

__all__ = [
    "METHODS",
    "FollowedPose",
    "RetargetSettings",
    "RetargetSpec",
    "Retargeter",
    "RetargeterSettings",
    "method_name",
    "retarget",
]
