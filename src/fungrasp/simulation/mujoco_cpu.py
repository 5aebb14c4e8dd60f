"""Many worlds of one scene, each with its own object, stepped together on a thread pool."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from fungrasp.geometry.poses import rotate
from fungrasp.simulation.scene import HAND_PREFIX, WRIST_JOINTS, Scene

INERTIAL = (
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
)
"""Model fields that follow from the object's mass."""

BREAKDOWNS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]
"""Warnings after which a world's motion means nothing."""


class Worlds:
    """W worlds. State arrays are live: writing to them changes the worlds."""

    def __init__(
        self,
        scene: Scene,
        object_index: np.ndarray,
        mass: np.ndarray | None = None,
        friction: np.ndarray | None = None,
        threads: int = 0,
    ):
        """
        Args:
            scene: the scene.
            object_index: which of ``scene.objects`` each world holds, shape [W].
            mass: of the object in each world [kg], shape [W]; the inertia follows. The objects' own if None.
            friction: sliding friction of hand, object and table in each world, shape [W]; the scene's if
                None.
            threads: 0 means all processors. Results do not depend on it.
        """
        self.scene, self.model = scene, scene.model
        count = len(object_index)
        self.object_index = np.zeros(count, dtype=int)
        # Persistent: the stages that make sensors current after a step are not computed twice.
        self.batch = Batch(scene.model, count, nthread=threads, persistent=True)
        self._object = scene.model.body("object").id
        self._object_qvel = int(scene.model.body_dofadr[self._object])
        self.assign(np.arange(count), object_index, mass, friction)
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.mocap_pos, self.mocap_quat = self.batch.bind("mocap_pos"), self.batch.bind("mocap_quat")
        self.sensordata = self.batch.bind("sensordata")
        self._xpos, self._xquat = self.batch.bind("xpos"), self.batch.bind("xquat")
        self._xipos = self.batch.bind("xipos")
        hand = scene.hand
        self._palm = scene.model.body(HAND_PREFIX + hand.palm).id
        self.object_qpos = _addresses(scene.model, ("object",))
        self.wrist_qpos = _addresses(scene.model, WRIST_JOINTS)
        self.wrist_qvel = np.array([scene.model.joint(name).dofadr[0] for name in WRIST_JOINTS])
        self.finger_qpos = _addresses(scene.model, tuple(HAND_PREFIX + name for name in hand.joint_names))
        self._link_object = _link_columns(scene, "object")
        self._link_table = _link_columns(scene, "table")
        self._object_table = scene.model.sensor("object/table").adr[0]
        self._hand_hand = scene.model.sensor("hand/hand").adr[0]

    def __len__(self) -> int:
        return len(self.object_index)

    def assign(
        self,
        ids: np.ndarray,
        object_index: np.ndarray,
        mass: np.ndarray | None = None,
        friction: np.ndarray | None = None,
    ) -> None:
        """Give some worlds another object, mass and friction; their state stays as it is.

        Args:
            ids: worlds, shape [I].
            object_index: which of ``scene.objects`` each holds, shape [I].
            mass: of the object [kg], shape [I]; the inertia follows. The objects' own if None.
            friction: sliding friction of hand, object and table, shape [I]; as it was if None.
        """
        self.object_index[ids] = object_index
        for name, table in self.scene.fields.items():
            self.batch.expand(name)[ids] = table[object_index]
        if mass is None:
            mass = self._nominal("body_mass", self.object_index[ids])[:, self._object]
        self._set_mass(ids, np.asarray(mass, dtype=float))
        if friction is not None:
            self.batch.expand("geom_friction")[ids, :, 0] = np.asarray(friction, dtype=float)[:, None]

    def reset(self, which: np.ndarray | None = None) -> None:
        """Worlds to the scene's default. which: world ids, all if None."""
        self.batch.reset(which, stage=mujoco.mjtStage.mjSTAGE_NONE)

    def forward(self, which: np.ndarray | None = None) -> None:
        """Make sensors and body poses current after writing to the state. which: world ids, all if None."""
        self.batch.forward(which, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def step(self, substeps: int, which: np.ndarray | None = None) -> None:
        """Advance by physics steps; sensors and poses are current afterwards. which: world ids, all if
        None."""
        self.batch.step(which, nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    @property
    def broken(self) -> np.ndarray:
        """Worlds whose physics has broken down since they were last reset, shape [W] bool.

        Their numbers don't show it: MuJoCo puts such a world back to the scene's default and goes on.
        """
        return (self.batch.warning[:, BREAKDOWNS, 1] > 0).any(axis=1)

    @property
    def object_pose(self) -> np.ndarray:
        """World frame, shape [W, 7]."""
        return self.qpos.take(self.object_qpos, axis=1)

    @object_pose.setter
    def object_pose(self, pose: np.ndarray) -> None:
        self.qpos[:, self.object_qpos] = pose

    @property
    def object_velocity(self) -> np.ndarray:
        """Linear [m/s] and angular [rad/s], world frame, shape [W, 6]."""
        velocity = self.qvel[:, self._object_qvel : self._object_qvel + 6]
        spin = rotate(self.object_pose[:, 3:], velocity[:, 3:])
        return np.concatenate([velocity[:, :3], spin], axis=1)

    @property
    def center_of_mass(self) -> np.ndarray:
        """Of the object [m], world frame, shape [W, 3]."""
        return self._xipos[:, self._object].copy()

    @property
    def palm_pose(self) -> np.ndarray:
        """World frame, shape [W, 7]."""
        return np.concatenate([self._xpos[:, self._palm], self._xquat[:, self._palm]], axis=1)

    @property
    def wrist_reference(self) -> np.ndarray:
        """Frame in which the wrist joints count, world frame, shape [W, 7]."""
        return np.concatenate([self.mocap_pos[:, 0], self.mocap_quat[:, 0]], axis=1)

    @wrist_reference.setter
    def wrist_reference(self, pose: np.ndarray) -> None:
        self.mocap_pos[:, 0], self.mocap_quat[:, 0] = pose[:, :3], pose[:, 3:]

    @property
    def joint_positions(self) -> np.ndarray:
        """Of the hand [rad], in ``Hand.joint_names`` order, shape [W, M]."""
        return self.qpos.take(self.finger_qpos, axis=1)

    @joint_positions.setter
    def joint_positions(self, value: np.ndarray) -> None:
        self.qpos[:, self.finger_qpos] = value

    @property
    def link_contacts(self) -> np.ndarray:
        """Whether each contact link touches the object, shape [W, L] bool."""
        return np.stack(
            [(self.sensordata[:, columns] > 0).any(axis=1) for columns in self._link_object], axis=1
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
    def hand_on_hand(self) -> np.ndarray:
        """Net force of the hand's contacts with itself [N], magnitude, shape [W]."""
        first = self._hand_hand + 1
        return np.linalg.norm(self.sensordata[:, first : first + 3], axis=1)

    @property
    def object_on_table(self) -> np.ndarray:
        """Whether the object touches the table, shape [W] bool."""
        return self.sensordata[:, self._object_table] > 0

    def _forces(self, links: list[np.ndarray]) -> np.ndarray:
        return np.stack(
            [
                np.linalg.norm(sum(self.sensordata[:, c + 1 : c + 4] for c in columns), axis=1)  # type: ignore[arg-type]
                for columns in links
            ],
            axis=1,
        )

    def _set_mass(self, ids: np.ndarray, mass: np.ndarray) -> None:
        """Scale the object's inertial fields; everything derived from them scales along, as the body floats
        freely."""
        index, body = self.object_index[ids], self._object
        first = self.model.body_dofadr[body]
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

    def _nominal(self, name: str, object_index: np.ndarray) -> np.ndarray:
        """A model field with the objects' own masses, one row for each object index given."""
        table = self.scene.fields.get(name)
        if table is not None:
            return table[object_index].copy()
        value = getattr(self.model, name)
        return np.broadcast_to(value, (len(object_index), *value.shape)).copy()


def _addresses(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    """Of the joints' numbers in qpos."""
    widths = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    return np.concatenate(
        [
            model.joint(j).qposadr[0] + np.arange(widths.get(mujoco.mjtJoint(int(model.joint(j).type[0])), 1))
            for j in joints
        ]
    )


def _link_columns(scene: Scene, other: str) -> list[np.ndarray]:
    """First column in sensordata of each link's sensors."""
    return [
        np.array([scene.model.sensor(f"{name}/{other}").adr[0] for name in members])
        for members in scene.hand.links
    ]
