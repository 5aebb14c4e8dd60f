"""The GPU engine: worlds of one scene in MuJoCo Warp (``fungrasp.simulation.warp_worlds``), seen as NumPy
arrays as those of all engines are."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import Array
from fungrasp.simulation.devices import BufferSizes, Device
from fungrasp.simulation.mujoco_engine import controls_of
from fungrasp.simulation.scene import Scene
from fungrasp.simulation.warp_worlds import MujocoWarpWorlds


class MujocoWarpEngine:
    """W worlds; see ``fungrasp.simulation.engine.Engine``. What is read is copied from the device, what is
    given to it."""

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

    @property
    def object_pose(self) -> np.ndarray:
        """Pose of the object, world frame, shape [W, 7]."""
        return _host(self.worlds.object_pose)

    @property
    def object_velocity(self) -> np.ndarray:
        """Linear [m/s] and angular [rad/s], world frame, shape [W, 6]."""
        return _host(self.worlds.object_velocity)

    @property
    def center_of_mass(self) -> np.ndarray:
        """Center of mass of the object [m], world frame, shape [W, 3]."""
        return _host(self.worlds.center_of_mass)

    @property
    def palm_pose(self) -> np.ndarray:
        """World frame, shape [W, 7]."""
        return _host(self.worlds.palm_pose)

    @property
    def joint_positions(self) -> np.ndarray:
        """Joints of the hand [rad], shape [W, M]."""
        return _host(self.worlds.joint_positions)

    @property
    def link_contacts(self) -> np.ndarray:
        """Whether each contact link touches the object, shape [W, L] bool."""
        return _host(self.worlds.link_contacts)

    @property
    def link_forces(self) -> np.ndarray:
        """Net contact force between each link and the object [N], magnitude, shape [W, L]."""
        return _host(self.worlds.link_forces)

    @property
    def table_forces(self) -> np.ndarray:
        """Net contact force between each link and the table [N], magnitude, shape [W, L]."""
        return _host(self.worlds.table_forces)

    @property
    def self_force(self) -> np.ndarray:
        """Net force of the hand's contacts with itself [N], magnitude, shape [W]."""
        return _host(self.worlds.self_force)

    @property
    def object_on_table(self) -> np.ndarray:
        """Whether the object touches the table, shape [W] bool."""
        return _host(self.worlds.object_on_table)

    @property
    def diverged(self) -> np.ndarray:
        """Worlds whose physics has broken down since they were last reset, shape [W] bool."""
        return _host(self.worlds.diverged)

    @property
    def positions(self) -> np.ndarray:
        """Generalised positions of ``scene.model``, shape [W, nq]."""
        return _host(self.worlds.positions)

    @property
    def wrist_frame(self) -> np.ndarray:
        """Frame in which the wrist's joints count, world frame, shape [W, 7]."""
        return _host(self.worlds.wrist_frame)

    def problems(self) -> list[str]:
        """See ``Engine.problems``."""
        return self.worlds.problems()

    def reset(self, worlds: np.ndarray | None = None) -> None:
        """Worlds to the scene's default state."""
        self.worlds.reset(worlds)

    def set_state(
        self,
        worlds: np.ndarray | None = None,
        *,
        object_pose: np.ndarray | None = None,
        wrist_frame: np.ndarray | None = None,
        palm_pose: np.ndarray | None = None,
        palm_velocity: np.ndarray | None = None,
        joint_positions: np.ndarray | None = None,
    ) -> None:
        """See ``Engine.set_state``."""
        self.worlds.set_state(
            worlds,
            object_pose=self._given(object_pose),
            wrist_frame=self._given(wrist_frame),
            palm_pose=self._given(palm_pose),
            palm_velocity=self._given(palm_velocity),
            joint_positions=self._given(joint_positions),
        )

    def set_parameters(self, worlds: np.ndarray | None = None, **parameters: np.ndarray | None) -> None:
        """See ``Engine.set_parameters``."""
        self.worlds.set_parameters(worlds, **parameters)

    def push_object(self, force: np.ndarray, torque: np.ndarray | None = None) -> None:
        """See ``Engine.push_object``."""
        given = self._given(force)
        assert given is not None
        self.worlds.push_object(given, self._given(torque))

    def controls(
        self, palm_pose: np.ndarray, palm_velocity: np.ndarray, finger_targets: np.ndarray
    ) -> np.ndarray:
        """See ``Engine.controls``; in double precision, on the processor."""
        return controls_of(
            _host(self.worlds.wrist_frame), self.worlds.lead, palm_pose, palm_velocity, finger_targets
        )

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.step``."""
        if worlds is not None and len(worlds) == len(self):
            worlds = None
        self.worlds.step(self._given(controls), steps, worlds)

    def get_state(self) -> list[Array]:
        """See ``Engine.get_state``."""
        return self.worlds.get_state()

    def restore(self, state: list[Array]) -> None:
        """See ``Engine.restore``."""
        self.worlds.restore(state)

    def _given(self, values: np.ndarray | None) -> Array | None:
        return None if values is None else self.worlds.tensor(values)


def _host(array: Array) -> np.ndarray:
    """A copy in the main memory, numbers in double precision."""
    values = array.cpu().numpy()
    return values.astype(np.float64 if values.dtype == np.float32 else values.dtype)
