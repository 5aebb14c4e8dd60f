"""Scenes, and many worlds stepped at once."""

from fungrasp.simulation.scene import Scene, SceneSettings, build_scene
from fungrasp.simulation.worlds import Worlds

__all__ = ["Scene", "SceneSettings", "Worlds", "build_scene"]
