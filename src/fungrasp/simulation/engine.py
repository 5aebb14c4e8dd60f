"""The engine interface: the physics that task, planning and evaluation use.

An engine steps W worlds of one scene, each with its own object, parameters and state. The first axis of
arrays is the world; arrays are copies. Every engine must pass ``tests/simulation/engine_contract.py``.
"""

from __future__ import annotations

from typing import Any, Protocol, Unpack

import numpy as np

from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene
from fungrasp.simulation.world_parameters import Parameters

EngineState = Any
"""A snapshot of the state of all worlds; the type depends on the engine."""


class Engine(Protocol):
    """W worlds of a scene: a hand on a floating wrist, an object, a table. World ids must be unique and
    increasing."""

    scene: Scene
    object_index: np.ndarray
    """Index into ``scene.objects`` for each world, shape [W] int."""

    def __len__(self) -> int:
        """Return the number of worlds W."""
        ...

    # State: current after ``set_state`` and ``step``. Contacts and their forces are those of the last physics
    # step: ``reset`` clears them, ``set_state`` and ``restore`` do not change them.

    @property
    def object_pose(self) -> np.ndarray:
        """Pose of the object, world frame, shape [W, 7]."""
        ...

    @property
    def object_velocity(self) -> np.ndarray:
        """Linear [m/s], then angular [rad/s] velocity of the object, world frame, shape [W, 6]."""
        ...

    @property
    def center_of_mass(self) -> np.ndarray:
        """Center of mass of the object [m], world frame, shape [W, 3]."""
        ...

    @property
    def palm_pose(self) -> np.ndarray:
        """Pose of the palm body, world frame, shape [W, 7]."""
        ...

    @property
    def joint_positions(self) -> np.ndarray:
        """Joints of the hand [rad], in ``Hand.joint_names`` order, shape [W, M]."""
        ...

    @property
    def link_contacts(self) -> np.ndarray:
        """Whether each contact link touches the object, shape [W, L] bool."""
        ...

    @property
    def link_forces(self) -> np.ndarray:
        """Magnitude of the net contact force between each link and the object [N], shape [W, L]."""
        ...

    @property
    def table_forces(self) -> np.ndarray:
        """Magnitude of the net contact force between each link and the table [N], shape [W, L]."""
        ...

    @property
    def self_force(self) -> np.ndarray:
        """Magnitude of the net force of the hand's contacts with itself [N], shape [W]."""
        ...

    @property
    def object_on_table(self) -> np.ndarray:
        """Whether the object touches the table, shape [W] bool."""
        ...

    @property
    def diverged(self) -> np.ndarray:
        """Worlds whose simulation became unstable since their last reset, shape [W] bool. Their other values
        are meaningless."""
        ...

    def problems(self) -> list[str]:
        """Return problems since the last call, except divergence: buffer overflows, frozen worlds, NaN
        commands. Each is one line with worlds and remedy. Called after each batch of episodes."""
        ...

    @property
    def positions(self) -> np.ndarray:
        """Generalized positions of ``scene.model``, shape [W, nq], for recordings and rendering."""
        ...

    @property
    def wrist_frame(self) -> np.ndarray:
        """Reference frame of the wrist's six joints, world frame, shape [W, 7]."""
        ...

    # Commands.

    def reset(self, worlds: np.ndarray | None = None) -> None:
        """Reset worlds to the scene's default state, without changing parameters. worlds: ids, shape [I]; all
        if None."""
        ...

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
        """Set poses and zero velocities. Omitted values stay unchanged.

        Args:
            worlds: ids, shape [I]; all if None.
            object_pose: world frame, shape [I, 7].
            wrist_frame: see ``wrist_frame``, shape [I, 7]. It should be near the palm's poses, because the
                wrist joints are Euler angles in it. It is also the palm pose if ``palm_pose`` is None.
            palm_pose: world frame, shape [I, 7].
            palm_velocity: linear, world frame [m/s], shape [I, 3]; zero if None.
            joint_positions: joints of the hand [rad], shape [I, M].
        """
        ...

    def set_parameters(
        self,
        worlds: np.ndarray | None = None,
        *,
        object_index: np.ndarray | None = None,
        **parameters: Unpack[Parameters],
    ) -> None:
        """Set physical parameters. Omitted values and the state stay unchanged.

        Args:
            worlds: ids, shape [I]; all if None.
            object_index: index into ``scene.objects`` for each world, shape [I]. Mass, center of mass,
                inertia and table height are reset to the scene's values unless given.
            parameters: one row for each world of ``worlds``.
        """
        ...

    def push_object(self, force: np.ndarray, torque: np.ndarray | None = None) -> None:
        """Apply forces to the objects until the next call or reset.

        Args:
            force: at the centers of mass, world frame [N], shape [W, 3].
            torque: world frame [N m], shape [W, 3]; zero if None.
        """
        ...

    def controls(
        self, palm_pose: np.ndarray, palm_velocity: np.ndarray, finger_targets: np.ndarray
    ) -> np.ndarray:
        """Return the servo controls for ``step``.

        Args:
            palm_pose: setpoint of the palm, world frame, shape [..., W, 7].
            palm_velocity: linear velocity of that setpoint, world frame [m/s], shape [..., W, 3]. It
                compensates the lag of damped servos.
            finger_targets: setpoints of the finger servos [rad], shape [..., W, U].

        Returns:
            Shape [..., W, 6 + U].
        """
        ...

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        """Advance by physics steps under constant controls.

        Args:
            controls: one row of ``controls`` for each world, shape [W, 6 + U].
            steps: number of physics steps of ``scene.settings.timestep``.
            worlds: ids to advance, shape [I]; all if None.
        """
        ...

    def get_state(self) -> EngineState:
        """Return a snapshot of all worlds. Restoring it reproduces the simulation exactly."""
        ...

    def restore(self, state: EngineState) -> None:
        """Restore a snapshot."""
        ...


def make_engine(scene: Scene, count: int, threads: int = 0, tensors: bool = False) -> Engine:
    """Create an engine with W worlds on the device of the scene's settings.

    Args:
        count: number of worlds W.
        threads: CPU threads, 0 for all processors.
        tensors: return torch tensors that share memory with the GPU, instead of NumPy copies.

    Raises:
        FungraspError: a package for the device is missing.
    """
    settings = scene.settings
    if settings.device == "cpu":
        return MujocoCpuEngine(scene, count, threads)
    from fungrasp.simulation.mujoco_warp import MujocoWarpEngine, MujocoWarpWorlds

    kind: Any = MujocoWarpWorlds if tensors else MujocoWarpEngine
    return kind(scene, count, settings.device, settings.buffers)
