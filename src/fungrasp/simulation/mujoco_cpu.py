"""The CPU engine: worlds of one scene on the thread pool of ``mujoco.batch``."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from mujoco.batch import Batch

from fungrasp.core.errors import FungraspError
from fungrasp.simulation.mujoco_engine import MujocoArrays
from fungrasp.simulation.scene import Scene
from fungrasp.simulation.world_parameters import FieldChange

DIVERGENCE_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]
"""MuJoCo warnings of an unstable simulation."""

_log = logging.getLogger(__name__)

_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class MujocoCpuEngine(MujocoArrays):
    """W worlds; see ``fungrasp.simulation.engine.Engine``. Results do not depend on the number of threads."""

    def __init__(self, scene: Scene, count: int, threads: int = 0):
        """
        Args:
            scene: the scene. All worlds start with its first object.
            count: number of worlds W.
            threads: number of threads; 0 for all processors.

        Raises:
            FungraspError: the number of threads is negative.
        """
        if threads < 0:
            raise FungraspError(f"the number of threads must not be negative, not {threads}")
        if mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(_warned)
        # Persistent: stages that update sensors after a step are not computed twice.
        self.batch = Batch(scene.model, count, nthread=threads, persistent=True)
        # Sparse Jacobians save 10 % of the time with equal results up to rounding. MuJoCo would choose dense
        # ones for a hand's number of joints.
        self.batch.expand("opt.jacobian")[:] = int(mujoco.mjtJacobian.mjJAC_SPARSE)
        self._set_up(scene, count)
        self.actuators = np.concatenate([scene.wrist_actuators, scene.finger_actuators])
        self._told = np.zeros(count, dtype=bool)

    @property
    def diverged(self) -> np.ndarray:
        """Worlds whose simulation became unstable since their last reset, shape [W] bool.

        Their state does not show it: MuJoCo resets such a world to the scene's default and continues.
        """
        return (self.batch.warning[:, DIVERGENCE_WARNINGS, 1] > 0).any(axis=1)

    def problems(self) -> list[str]:
        """See ``Engine.problems``."""
        full = (self.batch.warning[:, _FULL, 1] > 0).any(axis=1)
        new, self._told = full & ~self._told, full
        if not new.any():
            return []
        return [f"contacts were left out for want of memory in {worlds_named(new)}"]

    def reset(self, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.reset``."""
        self.batch.reset(worlds, stage=mujoco.mjtStage.mjSTAGE_NONE)
        which = slice(None) if worlds is None else worlds
        self._frame[which] = np.concatenate([self._mocap_pos[which, 0], self._mocap_quat[which, 0]], axis=1)

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.step``."""
        self._ctrl[:, self._servos] = controls
        self.batch.step(worlds, nstep=steps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def _array(self, name: str) -> np.ndarray:
        return self.batch.bind(name)

    def _native(self, indices: np.ndarray) -> np.ndarray:
        return np.asarray(indices)

    def _write(self, change: FieldChange) -> None:
        self.batch.expand(change.field)[change.index] = change.values

    def _forward(self, worlds: np.ndarray | None = None) -> None:
        """Update sensors too, except contacts and their forces."""
        self.batch.forward(worlds, stage=mujoco.mjtStage.mjSTAGE_VEL)


def worlds_named(which: np.ndarray) -> str:
    """Return text with the number of worlds and the first of them. which: shape [W] bool, at least one."""
    ids = np.flatnonzero(which)
    first = ", ".join(map(str, ids[:8].tolist())) + (", ..." if len(ids) > 8 else "")
    return f"world {first}" if len(ids) == 1 else f"{len(ids)} of {len(which)} worlds ({first})"


def _warned(text: str) -> None:
    """Log a warning of MuJoCo instead of printing it and writing a log file to the working directory.
    Instability is reported by ``MujocoCpuEngine.diverged``."""
    _log.log(logging.DEBUG if "unstable" in text else logging.WARNING, "MuJoCo: %s", text)
