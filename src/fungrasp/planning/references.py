"""References that learned policies follow: planned motions and what they aim at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fungrasp.geometry.poses import compose
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import Motion, raised
from fungrasp.task import LiftTask


@dataclass(frozen=True, eq=False)
class References:
    """N of them."""

    motion: Motion
    object_name: np.ndarray
    """Shape [N] str."""
    mass: np.ndarray
    """[kg], shape [N]."""
    settled_pose: np.ndarray
    """Of the object at rest on the table, world frame, shape [N, 7]."""
    contacts: np.ndarray
    """Links that should touch, shape [N, L] bool."""
    keypoints: np.ndarray
    """Of the hand in the grasp, object frame [m], shape [N, K, 3]."""

    def __len__(self) -> int:
        return len(self.mass)

    def select(self, rows: np.ndarray) -> References:
        """Some of them."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return References(
            self.motion.select(rows), **{name: v[rows] for name, v in values.items() if name != "motion"}
        )

    def raised(self, height: np.ndarray) -> References:
        """With their objects higher by [N] metres."""
        return replace(self, settled_pose=raised(self.settled_pose, height))

    def grasps(self, hand: Hand) -> RobotGraspSet:
        """As grasps on settled objects, for a task. hand: of the references."""
        matrix, offset = hand.coupling
        return RobotGraspSet(
            hand=hand.name,
            object_name=self.object_name,
            object_mass=self.mass,
            object_pose=self.settled_pose,
            object_rest_pose=self.settled_pose,
            wrist_pose=compose(self.settled_pose, self.motion.wrist),
            joint_names=hand.joint_names,
            joint_positions=self.motion.grasp @ matrix.T + offset,
            keypoints=self.keypoints,
            link_contacts=self.contacts,
            task=np.full(len(self), ""),
        )

    @classmethod
    def of(cls, motion: Motion, grasps: RobotGraspSet, settled_pose: np.ndarray, hand: Hand) -> References:
        """The references of grasps whose motions are planned.

        Args:
            motion: of N grasps.
            grasps: N of ``hand``.
            settled_pose: of the objects, world frame, shape [N, 7].
        """
        kinematics = HandKinematics(hand, len(grasps))
        joints = motion.grasp @ kinematics.matrix.T + kinematics.offset
        keypoints = kinematics.keypoints(motion.wrist, joints)
        return cls(
            motion, grasps.object_name, grasps.object_mass, settled_pose, grasps.link_contacts, keypoints
        )

    @classmethod
    def join(cls, parts: Sequence[References]) -> References:
        """One after the other; motions that end earlier stay where they end."""
        length = max(part.motion.wrist_goal.shape[1] for part in parts)
        motions = [_padded(part.motion, length) for part in parts]
        motion = Motion(*(np.concatenate([getattr(m, f.name) for m in motions]) for f in fields(Motion)))
        others = [f.name for f in fields(cls) if f.name != "motion"]
        return cls(motion, *(np.concatenate([getattr(part, name) for part in parts]) for name in others))

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything, to be kept in a file."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "motion"}
        return own | {f"motion_{f.name}": getattr(self.motion, f.name) for f in fields(Motion)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> References:
        """What ``arrays`` gave."""
        motion = Motion(*(arrays[f"motion_{f.name}"] for f in fields(Motion)))
        return cls(motion, *(arrays[f.name] for f in fields(cls) if f.name != "motion"))


def begin_on_way(
    task: LiftTask,
    ids: np.ndarray,
    references: References,
    rows: np.ndarray,
    step: np.ndarray,
    placed: np.ndarray | None = None,
) -> None:
    """Start trials of some worlds in the midst of their references' motions, objects at rest.

    Args:
        task: whose worlds hold the references' objects.
        ids: worlds, shape [I].
        references: to follow.
        rows: the reference of each of these worlds, shape [I].
        step: control step of the motion to start at, shape [I] int.
        placed: where the objects really are, world frame, shape [I, 7]; where the references have them if
            None.
    """
    motion, settled = references.motion, references.settled_pose[rows]
    task.begin(
        ids,
        settled if placed is None else placed,
        compose(settled, motion.wrist[rows]),
        compose(settled, motion.set_point[rows, step]),
        motion.finger_targets[rows, np.maximum(step - 1, 0)],
        references.contacts[rows],
        motion.velocity[rows, step],
        step * task.protocol.control_period,
    )


def object_tables(names: Sequence[str], objects: Mapping[str, ObjectModel]) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass and extents of objects, object frame [m], each of shape [number, 3]."""
    return (
        np.array([objects[name].center_of_mass for name in names]),
        np.array([objects[name].size for name in names]),
    )


def _padded(motion: Motion, length: int) -> Motion:
    def pad(values: np.ndarray) -> np.ndarray:
        if values.ndim < 3 or values.shape[1] >= length:
            return values
        return np.concatenate([values, np.repeat(values[:, -1:], length - values.shape[1], axis=1)], axis=1)

    return Motion(*(pad(getattr(motion, f.name)) for f in fields(motion)))
