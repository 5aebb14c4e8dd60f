"""Scenes, and engines that step many worlds of one at once."""

from fungrasp.simulation.engine import Engine
from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene, SceneSettings, build_scene

__all__ = ["Engine", "MujocoCpuEngine", "Scene", "SceneSettings", "build_scene"]
