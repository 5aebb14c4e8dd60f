"""The engine of a device."""

from __future__ import annotations

from fungrasp.simulation.engine import Engine
from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene


def make_engine(scene: Scene, count: int, threads: int = 0) -> Engine:
    """W worlds of a scene on the device that its settings name.

    Args:
        scene: the scene.
        count: W.
        threads: of the processor, 0 for all; a GPU has its own.

    Raises:
        FungraspError: something that the device needs is missing, in one line that says what to do.
    """
    settings = scene.settings
    if settings.device == "cpu":
        return MujocoCpuEngine(scene, count, threads)
    from fungrasp.simulation.mujoco_warp import MujocoWarpEngine

    return MujocoWarpEngine(scene, count, settings.device, settings.buffers)
