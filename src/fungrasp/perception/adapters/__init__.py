"""Readers for files of other estimators. Packages register estimators as entry points:
``fungrasp.hand_estimators``, functions of a ``Capture`` that return a ``HandEstimate``, and
``fungrasp.object_pose_estimators``, functions of a ``Capture`` and a mesh that return an ``ObjectEstimate``.
"""

from fungrasp.perception.adapters.hand_file import read_hand_estimate
from fungrasp.perception.adapters.object_file import read_object_pose

__all__ = ["read_hand_estimate", "read_object_pose"]
