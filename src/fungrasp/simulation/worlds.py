"""Many worlds of one scene, each with its own object, stepped together on a thread pool."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from fungrasp.simulation.scene import HAND_PREFIX, WRIST_JOINTS, Scene


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
        self.object_index = np.asarray(object_index)
        # Persistent: the stages that make sensors current after a step are not computed twice.
        self.batch = Batch(scene.model, len(self.object_index), nthread=threads, persistent=True)
        for name, table in scene.fields.items():
            self.batch.expand(name)[:] = table[self.object_index]
        self._object = scene.model.body("object").id
        if mass is not None:
            self._set_mass(np.asarray(mass, dtype=float))
        if friction is not None:
            self.batch.expand("geom_friction")[:, :, 0] = np.asarray(friction, dtype=float)[:, None]
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.mocap_pos, self.mocap_quat = self.batch.bind("mocap_pos"), self.batch.bind("mocap_quat")
        self.sensordata = self.batch.bind("sensordata")
        self._xpos, self._xquat = self.batch.bind("xpos"), self.batch.bind("xquat")
        self._xipos = self.batch.bind("xipos")
        hand = scene.hand
        self._palm = scene.model.body(HAND_PREFIX + hand.palm).id
        self.object_qpos = _addresses(scene.model, ("object",))
        self.wrist_qpos = _addresses(scene.model, WRIST_JOINTS)
        self.finger_qpos = _addresses(scene.model, tuple(HAND_PREFIX + name for name in hand.joint_names))
        self._link_object = _link_columns(scene, "object")
        self._link_table = _link_columns(scene, "table")
        self._object_table = scene.model.sensor("object/table").adr[0]
        self._hand_hand = scene.model.sensor("hand/hand").adr[0]

    def __len__(self) -> int:
        return len(self.object_index)

    def reset(self) -> None:
        """Every world to the scene's default."""
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)

    def forward(self) -> None:
        """Make sensors and body poses current after writing to the state."""
        self.batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)

    def step(self, substeps: int, which: np.ndarray | None = None) -> None:
        """Advance by physics steps; sensors and poses are current afterwards. which: world ids, all if
        None."""
        self.batch.step(which, nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    @property
    def object_pose(self) -> np.ndarray:
        """World frame, shape [W, 7]."""
        return self.qpos[:, self.object_qpos]

    @object_pose.setter
    def object_pose(self, pose: np.ndarray) -> None:
        self.qpos[:, self.object_qpos] = pose

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
        return self.qpos[:, self.finger_qpos]

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

    def _set_mass(self, mass: np.ndarray) -> None:
        """Scale the object's inertial fields; everything derived from them scales along, as the body floats
        freely."""
        fields = {
            name: self.batch.expand(name)
            for name in ("body_mass", "body_subtreemass", "body_inertia", "body_invweight0")
        }
        own = fields["body_mass"][:, self._object].copy()
        ratio = mass / own
        fields["body_subtreemass"][:, 0] += mass - own
        fields["body_mass"][:, self._object] *= ratio
        fields["body_subtreemass"][:, self._object] *= ratio
        fields["body_inertia"][:, self._object] *= ratio[:, None]
        fields["body_invweight0"][:, self._object] /= ratio[:, None]
        first = self.model.body_dofadr[self._object]
        self.batch.expand("dof_invweight0")[:, first : first + 6] /= ratio[:, None]
        self.batch.expand("dof_M0")[:, first : first + 6] *= ratio[:, None]


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
