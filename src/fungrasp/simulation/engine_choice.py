"""The engine of a device."""

from __future__ import annotations

from typing import Any

from fungrasp.simulation.engine import Engine
from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene


def make_engine(scene: Scene, count: int, threads: int = 0, tensors: bool = False) -> Engine:
    """W worlds of a scene on the device that its settings name.

    Args:
        scene: the scene.
        count: W.
        threads: of the processor, 0 for all; a GPU has its own.
        tensors: whether arrays of a GPU stay there, as torch tensors, and share memory with the physics; they
            are copied to NumPy's if not.

    Raises:
        FungraspError: something that the device needs is missing, in one line that says what to do.
    """
    settings = scene.settings
    if settings.device == "cpu":
        return MujocoCpuEngine(scene, count, threads)
    from fungrasp.simulation.mujoco_warp import MujocoWarpEngine
    from fungrasp.simulation.warp_worlds import MujocoWarpWorlds

    kind: Any = MujocoWarpWorlds if tensors else MujocoWarpEngine
    return kind(scene, count, settings.device, settings.buffers)
