"""Base class of engines with MuJoCo's arrays: setup, reading and writing.

The same code works with NumPy and torch arrays.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar, Unpack

import numpy as np

from fungrasp.geometry.arrays import copied, moved_to
from fungrasp.geometry.poses import Array, array_namespace, euler_angles, invert, norm, relative, rotate
from fungrasp.simulation.scene import HAND_PREFIX, WRIST_JOINTS, Scene
from fungrasp.simulation.world_parameters import FieldChange, Parameters, WorldParameters

Columns = Any
"""Column indices: a slice if they are consecutive, otherwise an array of the engine's library."""


class MujocoArrays:
    """W worlds of a scene whose state is in MuJoCo's arrays; see ``fungrasp.simulation.engine.Engine``."""

    STATE: ClassVar[tuple[str, ...]] = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")
    """Arrays of the physics state."""
    READ: ClassVar[tuple[str, ...]] = ("sensordata", "xfrc_applied", "xpos", "xquat", "xipos")
    """Other arrays that this class reads or writes."""

    scene: Scene
    object_index: np.ndarray
    """Index into ``scene.objects`` for each world, shape [W] int."""

    def _set_up(self, scene: Scene, count: int) -> None:
        """Find the indices into the existing arrays, and set the scene's parameters."""
        self.scene, self.model = scene, scene.model
        self.object_index = np.zeros(count, dtype=int)
        model, hand = scene.model, scene.hand
        arrays = {name: self._array(name) for name in self.STATE + self.READ}
        self._qpos, self._qvel, self._ctrl = arrays["qpos"], arrays["qvel"], arrays["ctrl"]
        self._mocap_pos, self._mocap_quat = arrays["mocap_pos"], arrays["mocap_quat"]
        self._sensors, self._force = arrays["sensordata"], arrays["xfrc_applied"]
        self._xpos, self._xquat, self._xipos = arrays["xpos"], arrays["xquat"], arrays["xipos"]
        self._warmstart = arrays["qacc_warmstart"]
        self._object = model.body("object").id
        self._palm = model.body(HAND_PREFIX + hand.palm).id
        first = int(model.joint("object").qposadr[0])
        self._object_qpos = slice(first, first + 7)
        first = int(model.joint("object").dofadr[0])
        self._object_qvel = slice(first, first + 6)
        wrist = [model.joint(name) for name in WRIST_JOINTS]
        fingers = [model.joint(HAND_PREFIX + name) for name in hand.joint_names]
        self._wrist_qpos = self._columns(joint.qposadr[0] for joint in wrist)
        self._wrist_slides = self._columns(joint.dofadr[0] for joint in wrist[:3])
        self._finger_qpos = self._columns(joint.qposadr[0] for joint in fingers)
        self._servos = self._columns([*scene.wrist_actuators, *scene.finger_actuators])
        self.lead = scene.settings.wrist_damping[0] / scene.settings.wrist_stiffness[0]
        """Lag of the wrist servos behind a moving setpoint [s]."""
        xp = array_namespace(self._qpos)
        self._frame = xp.zeros((count, 7), dtype=self._qpos.dtype, device=self._qpos.device)
        self._frame[:, 3] = 1.0
        self._link_object = self._link_sensors("object")
        self._link_table = self._link_sensors("table")
        self._object_table = int(model.sensor("object/table").adr[0])
        self._hand_hand = int(model.sensor("hand/hand").adr[0])
        self._parameters = WorldParameters(scene)
        self.set_parameters(object_index=self.object_index)

    def _array(self, name: str) -> Array:
        """Return a view of a field of MuJoCo's data, one row for each world."""
        raise NotImplementedError

    def _native(self, indices: np.ndarray | Array) -> Array:
        """Return indices as an array of the engine's library."""
        raise NotImplementedError

    def _write(self, change: FieldChange) -> None:
        """Write to a field of the model."""
        raise NotImplementedError

    def _forward(self, worlds: np.ndarray | None = None) -> None:
        """Update body poses after changes of the state."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self.object_index)

    @property
    def object_pose(self) -> Array:
        """World frame, shape [W, 7]."""
        pose = copied(self._qpos[:, self._object_qpos])
        pose[:, 3:] /= norm(pose[:, 3:])
        return pose

    @property
    def object_velocity(self) -> Array:
        """Linear [m/s] and angular [rad/s], world frame, shape [W, 6]."""
        velocity = self._qvel[:, self._object_qvel]
        # The angular velocity of a free joint is in the body frame.
        spin = rotate(self._qpos[:, self._object_qpos][:, 3:], velocity[:, 3:])
        return array_namespace(velocity).concat([velocity[:, :3], spin], axis=1)

    @property
    def center_of_mass(self) -> Array:
        """Center of mass of the object [m], world frame, shape [W, 3]."""
        return copied(self._xipos[:, self._object])

    @property
    def palm_pose(self) -> Array:
        """World frame, shape [W, 7]."""
        place, turn = self._xpos[:, self._palm], self._xquat[:, self._palm]
        return array_namespace(place).concat([place, turn], axis=1)

    @property
    def joint_positions(self) -> Array:
        """Joints of the hand [rad], shape [W, M]."""
        return copied(self._qpos[:, self._finger_qpos])

    @property
    def link_contacts(self) -> Array:
        """Whether each contact link touches the object, shape [W, L] bool."""
        found = [(self._sensors[:, first] > 0) & used for first, _, used in self._link_object]
        result = found[0]
        for more in found[1:]:
            result = result | more
        return result

    @property
    def link_forces(self) -> Array:
        """Net contact force between each link and the object [N], magnitude, shape [W, L]."""
        return self._forces(self._link_object)

    @property
    def table_forces(self) -> Array:
        """Net contact force between each link and the table [N], magnitude, shape [W, L]."""
        return self._forces(self._link_table)

    @property
    def self_force(self) -> Array:
        """Net force of the hand's contacts with itself [N], magnitude, shape [W]."""
        first = self._hand_hand + 1
        return _length(self._sensors[:, first : first + 3])

    @property
    def object_on_table(self) -> Array:
        """Whether the object touches the table, shape [W] bool."""
        return self._sensors[:, self._object_table] > 0

    @property
    def positions(self) -> Array:
        """Generalized positions of ``scene.model``, shape [W, nq]."""
        return copied(self._qpos)

    @property
    def wrist_frame(self) -> Array:
        """Reference frame of the wrist's joints, world frame, shape [W, 7]."""
        return copied(self._frame)

    def set_state(
        self,
        worlds: np.ndarray | None = None,
        *,
        object_pose: Array | None = None,
        wrist_frame: Array | None = None,
        palm_pose: Array | None = None,
        palm_velocity: Array | None = None,
        joint_positions: Array | None = None,
    ) -> None:
        """See ``Engine.set_state``."""
        ids = slice(None) if worlds is None else self._native(worlds)
        object_pose, wrist_frame, palm_pose, palm_velocity, joint_positions = (
            moved_to(self._qpos, given)
            for given in (object_pose, wrist_frame, palm_pose, palm_velocity, joint_positions)
        )
        self._qvel[ids] = 0.0
        if object_pose is not None:
            _put(self._qpos, ids, self._object_qpos, object_pose)
        if joint_positions is not None:
            _put(self._qpos, ids, self._finger_qpos, joint_positions)
        if wrist_frame is not None:
            self._frame[ids] = wrist_frame
            self._mocap_pos[ids, 0], self._mocap_quat[ids, 0] = wrist_frame[:, :3], wrist_frame[:, 3:]
            palm_pose = wrist_frame if palm_pose is None else palm_pose
        if palm_pose is not None:
            _put(self._qpos, ids, self._wrist_qpos, wrist_joints(self._frame[ids], palm_pose))
        if palm_velocity is not None:
            slides = rotate(invert(self._frame[ids])[:, 3:], palm_velocity)
            _put(self._qvel, ids, self._wrist_slides, slides)
        self._forward(worlds)

    def set_parameters(
        self,
        worlds: np.ndarray | None = None,
        *,
        object_index: np.ndarray | None = None,
        **parameters: Unpack[Parameters],
    ) -> None:
        """See ``Engine.set_parameters``. All values are NumPy arrays."""
        ids = np.arange(len(self)) if worlds is None else np.asarray(worlds)
        anew = object_index is not None
        if anew:
            self.object_index[ids] = object_index
        for change in self._parameters.changes(ids, self.object_index[ids], parameters, anew):
            self._write(change)

    def push_object(self, force: Array, torque: Array | None = None) -> None:
        """See ``Engine.push_object``."""
        self._force[:, self._object, :3] = moved_to(self._qpos, force)
        self._force[:, self._object, 3:] = 0.0 if torque is None else moved_to(self._qpos, torque)

    def controls(self, palm_pose: Array, palm_velocity: Array, finger_targets: Array) -> Array:
        """See ``Engine.controls``."""
        return controls_of(self._frame, self.lead, palm_pose, palm_velocity, finger_targets)

    def get_state(self) -> list[Array]:
        """See ``Engine.get_state``."""
        return [copied(array) for array in self._state_arrays()]

    def restore(self, state: list[Array]) -> None:
        """See ``Engine.restore``."""
        for array, value in zip(self._state_arrays(), state, strict=True):
            array[:] = moved_to(array, value)
        self._forward()

    def _state_arrays(self) -> list[Array]:
        wrist = [self._mocap_pos, self._mocap_quat, self._frame]
        return [self._qpos, self._qvel, self._ctrl, *wrist, self._warmstart]

    def _forces(self, links: list[tuple[Array, Array, Array]]) -> Array:
        """Return the norm of the sum of the member bodies' force vectors."""
        _, columns, used = links[0]
        total = self._sensors[:, columns] * used[:, None]
        for _, columns, used in links[1:]:
            total = total + self._sensors[:, columns] * used[:, None]
        return _length(total)

    def _link_sensors(self, other: str) -> list[tuple[Array, Array, Array]]:
        """Return the columns of link sensors in sensordata, one entry per member number k: columns of contact
        counts, shape [L], columns of forces, shape [L, 3], and whether each link has a member k, shape [L]
        bool."""
        links, result = self.scene.hand.links, []
        for k in range(max(len(members) for members in links)):
            names = [members[min(k, len(members) - 1)] for members in links]
            first = np.array([self.model.sensor(f"{name}/{other}").adr[0] for name in names])
            used = np.array([k < len(members) for members in links])
            columns = first[:, None] + np.arange(1, 4)
            result.append((self._native(first), self._native(columns), self._native(used)))
        return result

    def _columns(self, numbers: Iterable[int]) -> Columns:
        """Return columns as a slice if they are consecutive, otherwise as an array."""
        found = np.array(list(numbers), dtype=int)
        if np.array_equal(found, found[0] + np.arange(len(found))):
            return slice(int(found[0]), int(found[0]) + len(found))
        return self._native(found)


def _put(array: Array, ids: Any, columns: Columns, values: Array) -> None:
    """Write to a block of rows and columns."""
    if isinstance(ids, slice) or isinstance(columns, slice):
        array[ids, columns] = values
    else:
        array[ids[:, None], columns] = values


def _length(vectors: Array) -> Array:
    """Return the length of vectors, shape [...]. vectors: shape [..., 3]."""
    xp = array_namespace(vectors)
    return xp.sqrt(xp.sum(vectors * vectors, axis=-1))


def controls_of(
    frame: Array, lead: float, palm_pose: Array, palm_velocity: Array, finger_targets: Array
) -> Array:
    """Return the servo controls, shape [..., W, 6 + U].

    Args:
        frame: reference frame of the wrist's joints, world frame, shape [W, 7].
        lead: lag of the wrist servos [s].
        palm_pose, palm_velocity, finger_targets: as for ``Engine.controls``.
    """
    xp = array_namespace(palm_pose)
    place = palm_pose[..., :3] + lead * palm_velocity
    ahead = xp.concat([place, palm_pose[..., 3:]], axis=-1)
    return xp.concat([wrist_joints(frame, ahead), finger_targets], axis=-1)


def wrist_joints(frame: Array, palm_pose: Array) -> Array:
    """Return the positions of the wrist's three slides [m] and three hinges [rad], shape [..., W, 6].

    Args:
        frame: reference frame of the wrist's joints, world frame, shape [W, 7].
        palm_pose: world frame, shape [..., W, 7].
    """
    seen = relative(frame, palm_pose)
    return array_namespace(seen).concat([seen[..., :3], euler_angles(seen[..., 3:])], axis=-1)
