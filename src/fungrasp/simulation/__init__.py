"""Scenes, and many worlds stepped at once."""

from fungrasp.simulation.mujoco_cpu import Worlds
from fungrasp.simulation.scene import Scene, SceneSettings, build_scene

__all__ = ["Scene", "SceneSettings", "Worlds", "build_scene"]
