"""A human grasp, and sets of human grasps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fungrasp.grasps.grasp_set import ArrayField, GraspSet, check_rows
from fungrasp.grasps.human_hand import bone_lengths

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel

MAX_HAND_DISTANCE = 1.0
"""Largest distance between an object's origin and a joint of the grasping hand [m]."""

MAX_BONE_LENGTH = 0.3
"""Largest plausible bone length [m]; files in millimeters or centimeters exceed it."""

MIN_BONE_LENGTH = 1e-3
"""Smallest plausible bone length [m]; with shorter ones, joints coincide by mistake."""


@dataclass(frozen=True, eq=False, repr=False)
class HumanGrasp:
    """One human grasp. World frame, z up, table top at z = 0; poses ``[x y z qw qx qy qz]``."""

    object_name: str
    """Name of the object (``fungrasp.objects.load_object``)."""
    object_mass: float
    """Mass of the object [kg]."""
    object_pose: np.ndarray
    """Pose of the object when grasped, world frame, shape [7]."""
    object_rest_pose: np.ndarray
    """Pose of the object at rest on the table before the grasp, world frame, shape [7]."""
    hand_joints: np.ndarray
    """Joints [m] in the order of ``HUMAN_JOINTS``, world frame, shape [21, 3]."""
    link_contacts: np.ndarray
    """Which of ``HUMAN_LINKS`` touch the object, shape [16] bool."""
    task: str = ""
    """Task of the grasp: "drink", "cut", ...; empty if unknown."""
    hand_qpos: np.ndarray | None = None
    """Wrist position [m], wrist and 15 joint rotations as intrinsic XYZ Euler angles [rad], shape [51]."""
    object_mass_spread: float | None = None
    """Standard deviation of the logarithm of a guessed mass."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Models of objects by name, if attached; not written to files."""
    object_bounds: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Lowest and highest corner of the objects' meshes by name, if known, object frame [m], shape [2, 3]."""

    def save(self, path: str | Path) -> None:
        """Write a file with this grasp, see ``HumanGraspSet.save``."""
        HumanGraspSet.of([self]).save(path)

    def __repr__(self) -> str:
        return f"<HumanGrasp: object {self.object_name!r}, task {self.task!r}>"


@dataclass(frozen=True, eq=False, repr=False)
class HumanGraspSet(GraspSet[HumanGrasp]):
    """N human grasps: the fields of ``HumanGrasp`` with a leading axis N (float64, bool, str).

    Raises:
        FungraspError: wrong shape or type, values that are not finite, an invalid quaternion or mass, or
            joints that are not a hand in meters near the object; the message names field and row.
    """

    object_name: np.ndarray
    """Names of the objects, shape [N] str."""
    object_mass: np.ndarray
    """Masses of the objects [kg], shape [N]."""
    object_pose: np.ndarray
    """Poses of the objects when grasped, world frame, shape [N, 7]."""
    object_rest_pose: np.ndarray
    """Poses of the objects at rest on the table before the grasp, world frame, shape [N, 7]."""
    hand_joints: np.ndarray
    """Joints [m] in the order of ``HUMAN_JOINTS``, world frame, shape [N, 21, 3]."""
    link_contacts: np.ndarray
    """Which of ``HUMAN_LINKS`` touch the object, shape [N, 16] bool."""
    task: np.ndarray | None = None
    """Tasks of the grasps, shape [N] str; None becomes empty strings."""
    hand_qpos: np.ndarray | None = None
    """Wrist position [m], wrist and 15 joint rotations as intrinsic XYZ Euler angles [rad], shape [N, 51]."""
    object_mass_spread: np.ndarray | None = None
    """Standard deviation of the logarithm of guessed masses, shape [N]."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Models of objects by name, if attached; not written to files."""
    object_bounds: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Lowest and highest corner of the objects' meshes by name, if known, object frame [m], shape [2, 3]."""

    FIELDS: ClassVar = {
        "object_name": ArrayField("name", ("N",)),
        "object_mass": ArrayField("positive", ("N",)),
        "object_pose": ArrayField("pose", ("N", 7)),
        "object_rest_pose": ArrayField("pose", ("N", 7)),
        "hand_joints": ArrayField("number", ("N", 21, 3)),
        "link_contacts": ArrayField("flag", ("N", 16)),
        "task": ArrayField("text", ("N",), optional=True),
        "hand_qpos": ArrayField("number", ("N", 51), optional=True),
        "object_mass_spread": ArrayField("positive", ("N",), optional=True),
    }
    GRASP: ClassVar = HumanGrasp

    def __post_init__(self) -> None:
        super().__post_init__()
        bones = bone_lengths(self.hand_joints)
        longest, shortest = bones.max(axis=1, initial=0), bones.min(axis=1, initial=np.inf)
        check_rows(
            "hand_joints", longest <= MAX_BONE_LENGTH, "is not a hand in m; its longest bone [m]", longest
        )
        words = "has joints that coincide; its shortest bone [m]"
        check_rows("hand_joints", shortest >= MIN_BONE_LENGTH, words, shortest)
        apart = np.linalg.norm(self.hand_joints - self.object_pose[:, None, :3], axis=-1)
        far = apart.max(axis=1, initial=0)
        words = "is far from the object; the farthest joint [m]"
        check_rows("hand_joints", far <= MAX_HAND_DISTANCE, words, far)
