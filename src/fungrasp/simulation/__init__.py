"""Scenes, and engines that simulate many worlds of a scene in parallel."""

from fungrasp.simulation.devices import BufferSizes, Device, found_device
from fungrasp.simulation.engine import Engine, make_engine
from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene, SceneSettings, build_scene

__all__ = [
    "BufferSizes",
    "Device",
    "Engine",
    "MujocoCpuEngine",
    "Scene",
    "SceneSettings",
    "build_scene",
    "found_device",
    "make_engine",
]
