"""The CPU engine: worlds of one scene on the thread pool of ``mujoco.batch``."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import (
    euler_angles,
    invert,
    norm,
    quaternion_from_rotation_vector,
    relative,
    rotate,
)
from fungrasp.simulation.floating_body import floating_body_fields
from fungrasp.simulation.scene import HAND_PREFIX, WRIST_JOINTS, Scene

INERTIAL = (
    "body_mass",
    "body_subtreemass",
    "body_ipos",
    "body_iquat",
    "body_inertia",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
)
"""Model fields that follow from the object's mass and where it is."""

DIVERGENCE_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]
"""Warnings after which a world's motion means nothing."""

_SAMEFRAME_NONE = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


class MujocoCpuEngine:
    """W worlds; see ``fungrasp.simulation.engine.Engine``. Results do not depend on the number of threads."""

    def __init__(self, scene: Scene, count: int, threads: int = 0):
        """
        Args:
            scene: the scene; all worlds hold its first object until ``set_parameters`` says otherwise.
            count: W, the number of worlds.
            threads: 0 means all processors.

        Raises:
            FungraspError: the number of threads is negative.
        """
        if threads < 0:
            raise FungraspError(f"the number of threads must not be negative, not {threads}")
        self.scene, self.model = scene, scene.model
        self.object_index = np.zeros(count, dtype=int)
        # Persistent: the stages that make sensors current after a step are not computed twice.
        self.batch = Batch(scene.model, count, nthread=threads, persistent=True)
        model, hand = scene.model, scene.hand
        self._object = model.body("object").id
        self._palm = model.body(HAND_PREFIX + hand.palm).id
        self._table = model.geom("table").id
        self._object_geoms = np.flatnonzero(model.geom_bodyid == self._object)
        bind = self.batch.bind
        self._qpos, self._qvel, self._ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._mocap_pos, self._mocap_quat = bind("mocap_pos"), bind("mocap_quat")
        self._sensors, self._force = bind("sensordata"), bind("xfrc_applied")
        self._xpos, self._xquat, self._xipos = bind("xpos"), bind("xquat"), bind("xipos")
        self._warmstart = bind("qacc_warmstart")
        finger_joints = [HAND_PREFIX + name for name in hand.joint_names]
        self._object_qpos = model.joint("object").qposadr[0] + np.arange(7)
        self._object_qvel = int(model.joint("object").dofadr[0])
        self._wrist_qpos = np.array([model.joint(name).qposadr[0] for name in WRIST_JOINTS])
        self._wrist_qvel = np.array([model.joint(name).dofadr[0] for name in WRIST_JOINTS])
        self._finger_qpos = np.array([model.joint(name).qposadr[0] for name in finger_joints])
        self._finger_dofs = np.array([model.joint(name).dofadr[0] for name in finger_joints])
        self.actuators = np.concatenate([scene.wrist_actuators, scene.finger_actuators])
        self._lead = scene.settings.wrist_damping[0] / scene.settings.wrist_stiffness[0]
        self._frame = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
        self._link_object = _link_columns(scene, "object")
        self._link_table = _link_columns(scene, "table")
        self._object_table = model.sensor("object/table").adr[0]
        self._hand_hand = model.sensor("hand/hand").adr[0]
        self.set_parameters(object_index=self.object_index)

    def __len__(self) -> int:
        return len(self.object_index)

    @property
    def object_pose(self) -> np.ndarray:
        """World frame, shape [W, 7]."""
        pose = self._qpos.take(self._object_qpos, axis=1)
        pose[:, 3:] /= norm(pose[:, 3:])
        return pose

    @property
    def object_velocity(self) -> np.ndarray:
        """Linear [m/s] and angular [rad/s], world frame, shape [W, 6]."""
        velocity = self._qvel[:, self._object_qvel : self._object_qvel + 6]
        # A free joint's angular velocity is in the body's frame.
        spin = rotate(self._qpos.take(self._object_qpos[3:], axis=1), velocity[:, 3:])
        return np.concatenate([velocity[:, :3], spin], axis=1)

    @property
    def center_of_mass(self) -> np.ndarray:
        """Center of mass of the object [m], world frame, shape [W, 3]."""
        return self._xipos[:, self._object].copy()

    @property
    def palm_pose(self) -> np.ndarray:
        """World frame, shape [W, 7]."""
        return np.concatenate([self._xpos[:, self._palm], self._xquat[:, self._palm]], axis=1)

    @property
    def joint_positions(self) -> np.ndarray:
        """Joints of the hand [rad], shape [W, M]."""
        return self._qpos.take(self._finger_qpos, axis=1)

    @property
    def link_contacts(self) -> np.ndarray:
        """Whether each contact link touches the object, shape [W, L] bool."""
        return np.stack(
            [(self._sensors[:, columns] > 0).any(axis=1) for columns in self._link_object], axis=1
        )

    @property
    def link_forces(self) -> np.ndarray:
        """Net contact force between each link and the object [N], magnitude, shape [W, L]."""
        return self._forces(self._link_object)

    @property
    def table_forces(self) -> np.ndarray:
        """Net contact force between each link and the table [N], magnitude, shape [W, L]."""
        return self._forces(self._link_table)

    @property
    def self_force(self) -> np.ndarray:
        """Net force of the hand's contacts with itself [N], magnitude, shape [W]."""
        first = self._hand_hand + 1
        return np.linalg.norm(self._sensors[:, first : first + 3], axis=1)

    @property
    def object_on_table(self) -> np.ndarray:
        """Whether the object touches the table, shape [W] bool."""
        return self._sensors[:, self._object_table] > 0

    @property
    def diverged(self) -> np.ndarray:
        """Worlds whose physics has broken down since they were last reset, shape [W] bool.

        Their numbers don't show it: MuJoCo puts such a world back to the scene's default and goes on.
        """
        return (self.batch.warning[:, DIVERGENCE_WARNINGS, 1] > 0).any(axis=1)

    @property
    def positions(self) -> np.ndarray:
        """Generalised positions of ``scene.model``, shape [W, nq]."""
        return self._qpos.copy()

    @property
    def wrist_frame(self) -> np.ndarray:
        """Frame in which the wrist's joints count, world frame, shape [W, 7]."""
        return self._frame.copy()

    def reset(self, worlds: np.ndarray | None = None) -> None:
        """Worlds to the scene's default state."""
        self.batch.reset(worlds, stage=mujoco.mjtStage.mjSTAGE_NONE)
        which = slice(None) if worlds is None else worlds
        self._frame[which] = np.concatenate([self._mocap_pos[which, 0], self._mocap_quat[which, 0]], axis=1)

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
        ids = np.arange(len(self)) if worlds is None else worlds
        self._qvel[ids] = 0.0
        if object_pose is not None:
            self._qpos[np.ix_(ids, self._object_qpos)] = object_pose
        if joint_positions is not None:
            self._qpos[np.ix_(ids, self._finger_qpos)] = joint_positions
        if wrist_frame is not None:
            self._frame[ids] = wrist_frame
            self._mocap_pos[ids, 0], self._mocap_quat[ids, 0] = wrist_frame[:, :3], wrist_frame[:, 3:]
            palm_pose = wrist_frame if palm_pose is None else palm_pose
        if palm_pose is not None:
            self._qpos[np.ix_(ids, self._wrist_qpos)] = _wrist_joints(self._frame[ids], palm_pose)
        if palm_velocity is not None:
            slides = rotate(invert(self._frame[ids])[:, 3:], palm_velocity)
            self._qvel[np.ix_(ids, self._wrist_qvel[:3])] = slides
        self._forward(worlds)

    def set_parameters(
        self,
        worlds: np.ndarray | None = None,
        *,
        object_index: np.ndarray | None = None,
        object_mass: np.ndarray | None = None,
        object_center: np.ndarray | None = None,
        object_inertia: np.ndarray | None = None,
        friction: np.ndarray | None = None,
        table_height: np.ndarray | None = None,
        table_tilt: np.ndarray | None = None,
        joint_friction: np.ndarray | None = None,
        joint_damping: np.ndarray | None = None,
        servo_stiffness: np.ndarray | None = None,
        servo_damping: np.ndarray | None = None,
        wrist_stiffness: np.ndarray | None = None,
    ) -> None:
        """See ``Engine.set_parameters``."""
        ids = np.arange(len(self)) if worlds is None else np.asarray(worlds)
        if object_index is not None:
            self.object_index[ids] = object_index
            for name, table in self.scene.fields.items():
                self.batch.expand(name)[ids] = table[object_index]
            if object_mass is None:
                object_mass = self._nominal("body_mass", self.object_index[ids])[:, self._object]
            if table_height is None:
                table_height = np.zeros(len(ids))
        if object_mass is not None:
            self._set_mass(ids, np.asarray(object_mass, dtype=float))
        if object_center is not None:
            if object_mass is None or object_inertia is None:
                raise FungraspError("a center of mass is given together with mass and inertia")
            self._set_center(ids, np.asarray(object_mass, dtype=float), object_center, object_inertia)
        if friction is not None:
            self.batch.expand("geom_friction")[ids, :, 0] = np.asarray(friction, dtype=float)[:, None]
        if joint_friction is not None:
            dofs, dry = self._finger_dofs, np.asarray(joint_friction, dtype=float)
            own = self.model.dof_frictionloss[dofs]
            self.batch.expand("dof_frictionloss")[ids[:, None], dofs] = own + dry
        if joint_damping is not None:
            self._scale("dof_damping", ids, (self._finger_dofs,), joint_damping)
        # A position servo pulls with gain[0] * ctrl + bias[1] * angle + bias[2] * velocity.
        fingers, wrist = self.scene.finger_actuators, self.scene.wrist_actuators
        if servo_stiffness is not None:
            self._scale("actuator_gainprm", ids, (fingers, 0), servo_stiffness)
            self._scale("actuator_biasprm", ids, (fingers, 1), servo_stiffness)
        if servo_damping is not None:
            self._scale("actuator_biasprm", ids, (fingers, 2), servo_damping)
        if wrist_stiffness is not None:
            factor = np.repeat(np.asarray(wrist_stiffness, dtype=float)[:, None], len(wrist), axis=1)
            for name, column in (("actuator_gainprm", 0), ("actuator_biasprm", 1), ("actuator_biasprm", 2)):
                self._scale(name, ids, (wrist, column), factor)
        if table_height is not None:
            top = self.model.geom_pos[self._table, 2] + np.asarray(table_height, dtype=float)
            self.batch.expand("geom_pos")[ids, self._table, 2] = top
        if table_tilt is not None:
            turn = np.concatenate([table_tilt, np.zeros((len(ids), 1))], axis=1)
            self.batch.expand("geom_quat")[ids, self._table] = quaternion_from_rotation_vector(turn)
        if table_height is not None or table_tilt is not None:
            # MuJoCo skips the pose of a geom that the compiler found at its body's origin.
            self.batch.expand("geom_sameframe")[ids, self._table] = _SAMEFRAME_NONE

    def push_object(self, force: np.ndarray, torque: np.ndarray | None = None) -> None:
        """See ``Engine.push_object``."""
        self._force[:, self._object, :3] = force
        self._force[:, self._object, 3:] = 0.0 if torque is None else torque

    def controls(
        self, palm_pose: np.ndarray, palm_velocity: np.ndarray, finger_targets: np.ndarray
    ) -> np.ndarray:
        """See ``Engine.controls``."""
        ahead = palm_pose.copy()
        ahead[..., :3] += self._lead * palm_velocity
        return np.concatenate([_wrist_joints(self._frame, ahead), finger_targets], axis=-1)

    def step(self, controls: np.ndarray, steps: int, worlds: np.ndarray | None = None) -> None:
        """See ``Engine.step``."""
        self._ctrl[:, self.actuators] = controls
        self.batch.step(worlds, nstep=steps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def get_state(self) -> list[np.ndarray]:
        """See ``Engine.get_state``."""
        return [array.copy() for array in self._state_arrays()]

    def restore(self, state: list[np.ndarray]) -> None:
        """See ``Engine.restore``."""
        for array, value in zip(self._state_arrays(), state, strict=True):
            array[:] = value
        self._forward()

    def _state_arrays(self) -> list[np.ndarray]:
        wrist = [self._mocap_pos, self._mocap_quat, self._frame]
        return [self._qpos, self._qvel, self._ctrl, *wrist, self._warmstart]

    def _forward(self, worlds: np.ndarray | None = None) -> None:
        """Make sensors and body poses current after writing to the state."""
        self.batch.forward(worlds, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def _forces(self, links: list[np.ndarray]) -> np.ndarray:
        """Norm of the sum of the members' force vectors, which follow each sensor's first number."""
        total = [np.sum([self._sensors[:, c + 1 : c + 4] for c in columns], axis=0) for columns in links]
        return np.linalg.norm(np.stack(total, axis=1), axis=2)

    def _scale(
        self,
        name: str,
        ids: np.ndarray,
        index: tuple[np.ndarray] | tuple[np.ndarray, int],
        factor: np.ndarray,
    ) -> None:
        """Set entries of a model field of some worlds to the scene's values times factors [I, ...]."""
        self.batch.expand(name)[(ids[:, None], *index)] = getattr(self.model, name)[index] * factor

    def _set_mass(self, ids: np.ndarray, mass: np.ndarray) -> None:
        """Scale the object's inertial fields; everything derived from them scales along, as the body floats
        freely."""
        index, body = self.object_index[ids], self._object
        first = self._object_qvel
        nominal = {name: self._nominal(name, index) for name in INERTIAL}
        own = nominal["body_mass"][:, body].copy()
        ratio = (mass / own)[:, None]
        nominal["body_subtreemass"][:, 0] += mass - own
        for name in ("body_mass", "body_subtreemass", "body_inertia"):
            nominal[name][:, body] *= ratio.reshape(-1, *(1,) * (nominal[name].ndim - 2))
        nominal["body_invweight0"][:, body] /= ratio
        nominal["dof_invweight0"][:, first : first + 6] /= ratio
        nominal["dof_M0"][:, first : first + 6] *= ratio
        for name, values in nominal.items():
            self.batch.expand(name)[ids] = values

    def _set_center(self, ids: np.ndarray, mass: np.ndarray, center: np.ndarray, inertia: np.ndarray) -> None:
        """Where the object's mass is, and its inertia about there; see ``Engine.set_parameters``."""
        body, joint = floating_body_fields(mass, np.asarray(center, dtype=float), np.asarray(inertia))
        for name, values in body.items():
            self.batch.expand(name)[ids, self._object] = values
        for name, values in joint.items():
            self.batch.expand(name)[ids, self._object_qvel : self._object_qvel + 6] = values
        # MuJoCo skips the frame of an inertia that the compiler found aligned with its body, and turns geoms
        # that it found aligned with the inertia along with that.
        self.batch.expand("body_sameframe")[ids, self._object] = _SAMEFRAME_NONE
        self.batch.expand("geom_sameframe")[np.ix_(ids, self._object_geoms)] = _SAMEFRAME_NONE

    def _nominal(self, name: str, object_index: np.ndarray) -> np.ndarray:
        """A model field with the objects' own masses, one row for each object index given."""
        table = self.scene.fields.get(name)
        if table is not None:
            return table[object_index].copy()
        value = getattr(self.model, name)
        return np.broadcast_to(value, (len(object_index), *value.shape)).copy()


def _wrist_joints(frame: np.ndarray, palm_pose: np.ndarray) -> np.ndarray:
    """Positions of the wrist's three slides [m] and three hinges [rad], shape [..., W, 6].

    Args:
        frame: in which they count, world frame, shape [W, 7].
        palm_pose: world frame, shape [..., W, 7].
    """
    seen = relative(frame, palm_pose)
    return np.concatenate([seen[..., :3], euler_angles(seen[..., 3:])], axis=-1)


def _link_columns(scene: Scene, other: str) -> list[np.ndarray]:
    """First column in sensordata of each link's sensors."""
    return [
        np.array([scene.model.sensor(f"{name}/{other}").adr[0] for name in members])
        for members in scene.hand.links
    ]
