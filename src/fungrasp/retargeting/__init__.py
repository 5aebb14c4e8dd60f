"""Retargeting of human grasps to robot hands (paper IV.A), and baselines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.retargeting.human_to_robot import retarget
    from fungrasp.retargeting.retargeter import FollowedPose, Retargeter, RetargeterSettings
    from fungrasp.retargeting.settings import METHODS, RetargetSettings, RetargetSpec, method_name

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

__getattr__ = lazy_names(
    __name__,
    {
        "human_to_robot": "retarget",
        "retargeter": "FollowedPose Retargeter RetargeterSettings",
        "settings": "METHODS RetargetSettings RetargetSpec method_name",
    },
)
