"""The GPU engine: worlds of one scene in MuJoCo Warp (``fungrasp.simulation.warp_worlds``), seen as NumPy
arrays as those of all engines are."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.geometry.poses import Array
from fungrasp.simulation.devices import BufferSizes, Device
from fungrasp.simulation.mujoco_engine import controls_of
from fungrasp.simulation.scene import Scene
from fungrasp.simulation.warp_worlds import MujocoWarpWorlds


class MujocoWarpEngine:
    """W worlds; see ``fungrasp.simulation.engine.Engine``. What is read is copied from the device, in double
    precision, what is given to it."""

    def __init__(
        self,
        scene: Scene,
        count: int,
        device: Device = "cuda",
        sizes: BufferSizes | None = None,
    ):
        """Arguments and errors: see ``MujocoWarpWorlds``."""
        self.worlds = MujocoWarpWorlds(scene, count, device, sizes)
        self.scene, self.object_index = scene, self.worlds.object_index

    def __len__(self) -> int:
        return len(self.worlds)

    def __getattr__(self, name: str) -> Any:
        """What the worlds have of this name; a copy of what is on the device."""
        if name == "worlds":
            raise AttributeError(name)
        found = getattr(self.worlds, name)
        return _host(found) if hasattr(found, "device") else found

    def controls(
        self, palm_pose: np.ndarray, palm_velocity: np.ndarray, finger_targets: np.ndarray
    ) -> np.ndarray:
        """See ``Engine.controls``; in double precision, on the processor."""
        return controls_of(self.wrist_frame, self.worlds.lead, palm_pose, palm_velocity, finger_targets)

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.step``."""
        everyone = worlds is not None and len(worlds) == len(self)
        self.worlds.step(controls, steps, None if everyone else worlds)


def _host(array: Array) -> np.ndarray:
    """A copy in the main memory, numbers in double precision."""
    values = array.cpu().numpy()
    return values.astype(np.float64 if values.dtype == np.float32 else values.dtype)
