"""A robot grasp, and sets of grasps of one hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps.grasp_set import ArrayField, GraspSet, check_rows, checked_extra
from fungrasp.grasps.human_grasp import MAX_HAND_DISTANCE

if TYPE_CHECKING:
    import mujoco

    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel

EXTRA = "extra/"
"""Prefix of the names of ``extra`` values in files."""

SQUEEZE = "squeeze_positions"
"""Name in ``extra`` of squeeze targets."""

MASS_SPREAD = "object_mass_spread"
"""Name in ``extra`` of the uncertainty of guessed masses."""


@dataclass(frozen=True, eq=False, repr=False)
class RobotGrasp:
    """One robot grasp. World frame, z up, table top at z = 0; poses ``[x y z qw qx qy qz]``."""

    hand: str
    """Name of the hand (``fungrasp.hands.load_hand``)."""
    object_name: str
    """Name of the object (``fungrasp.objects.load_object``)."""
    object_mass: float
    """Mass of the object [kg]."""
    object_pose: np.ndarray
    """Pose of the object when grasped, world frame, shape [7]."""
    object_rest_pose: np.ndarray
    """Pose of the object at rest on the table before the grasp, world frame, shape [7]."""
    wrist_pose: np.ndarray
    """Pose of the palm body when the object is at ``object_pose``, world frame, shape [7]."""
    joint_names: tuple[str, ...]
    """All joints of the hand's model, including coupled joints, length M."""
    joint_positions: np.ndarray
    """Joint positions [rad], in the order of ``joint_names``, shape [M]."""
    keypoints: np.ndarray
    """Key points of the hand [m], world frame, shape [K, 3]."""
    link_contacts: np.ndarray
    """Contact links that should touch the object, shape [L] bool."""
    task: str = ""
    """Task of the grasp; empty if unknown."""
    shown_places: np.ndarray | None = None
    """Human contact point of each finger link (``grasps.as_shown``), object frame [m], shape [L - 1, 3]; None
    if unknown."""
    shown_normals: np.ndarray | None = None
    """Outward unit normals of the surface at these points, object frame, shape [L - 1, 3]."""
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Additional values by name (quality, controller settings)."""
    hand_file: str = ""
    """TOML file of a hand that is not registered by name."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Models of objects by name, if attached; not written to files."""
    object_bounds: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Lowest and highest corner of the objects' meshes by name, if known, object frame [m], shape [2, 3]."""

    @property
    def wrist_pose_object(self) -> np.ndarray:
        """Pose of the palm body, object frame, shape [7]."""
        return compose(invert(self.object_pose), self.wrist_pose)

    def joint_dict(self) -> dict[str, float]:
        """Return the joint positions by name [rad], including coupled joints."""
        return dict(zip(self.joint_names, self.joint_positions.tolist(), strict=True))

    def joints_in_order(self, names: Sequence[str]) -> np.ndarray:
        """Return the joint positions in the order of ``names`` [rad], shape [len(names)].

        Raises:
            FungraspError: the hand does not have one of the joints.
        """
        return self.joint_positions[_columns(self.joint_names, names)]

    def to_mjspec(self) -> mujoco.MjSpec:
        """Return a MuJoCo model of the hand with the palm at ``wrist_pose``. Its keyframe "grasp" contains
        the joint positions and servo targets.

        Raises:
            FungraspError: the hand is not found, or its version differs.
        """
        hand = RobotGraspSet.of([self]).load_hand()
        spec = hand.spec()
        palm = spec.body(hand.palm)
        palm.pos, palm.quat = self.wrist_pose[:3], self.wrist_pose[3:]
        told = hand.independent(self.joint_positions)
        spec.add_key(name="grasp", qpos=self.joint_positions.tolist(), ctrl=told.tolist())
        return spec

    def to_urdf(self, path: str | Path) -> dict[str, float]:
        """Write the hand as a URDF with meshes in a folder ``meshes`` next to it.

        Returns:
            ``joint_dict()``, since a URDF contains no joint positions.

        Raises:
            FungraspError: the hand is not found or not supported by URDF, or a file cannot be written.
        """
        import xml.etree.ElementTree as xml

        from fungrasp.core.files import atomic_path
        from fungrasp.hands.export import model_urdf

        path, hand = Path(path), RobotGraspSet.of([self]).load_hand()
        root = model_urdf(hand.name, hand.model, path.parent / "meshes")
        with atomic_path(path) as temporary:
            temporary.write_text(xml.tostring(root, encoding="unicode") + "\n")
        return self.joint_dict()

    def save(self, path: str | Path) -> None:
        """Write a file with this grasp, see ``RobotGraspSet.save``."""
        RobotGraspSet.of([self]).save(path)

    def __repr__(self) -> str:
        return f"<RobotGrasp: hand {self.hand!r}, object {self.object_name!r}, task {self.task!r}>"


@dataclass(frozen=True, eq=False, repr=False)
class RobotGraspSet(GraspSet[RobotGrasp]):
    """N grasps of one robot hand: the fields of ``RobotGrasp`` with a leading axis N (float64, bool, str);
    ``hand`` and ``joint_names`` belong to the set.

    Raises:
        FungraspError: wrong shape or type, values that are not finite, an invalid quaternion or mass, or a
            wrist far from the object; the message names field and row.
    """

    hand: str
    """Name of the hand (``fungrasp.hands.load_hand``)."""
    object_name: np.ndarray
    """Names of the objects, shape [N] str."""
    object_mass: np.ndarray
    """Masses of the objects [kg], shape [N]."""
    object_pose: np.ndarray
    """Poses of the objects when grasped, world frame, shape [N, 7]."""
    object_rest_pose: np.ndarray
    """Poses of the objects at rest on the table before the grasp, world frame, shape [N, 7]."""
    wrist_pose: np.ndarray
    """Poses of the palm body when the object is at ``object_pose``, world frame, shape [N, 7]."""
    joint_names: Sequence[str]
    """All joints of the hand's model, including coupled joints, length M; converted to a tuple."""
    joint_positions: np.ndarray
    """Joint positions [rad], in the order of ``joint_names``, shape [N, M]."""
    keypoints: np.ndarray
    """Key points of the hand [m], world frame, shape [N, K, 3]."""
    link_contacts: np.ndarray
    """Contact links that should touch the object, shape [N, L] bool."""
    task: np.ndarray | None = None
    """Tasks of the grasps, shape [N] str; None becomes empty strings."""
    shown_places: np.ndarray | None = None
    """Human contact point of each finger link, object frame [m], shape [N, L - 1, 3]; None if unknown."""
    shown_normals: np.ndarray | None = None
    """Outward unit normals of the surfaces at these points, object frame, shape [N, L - 1, 3]."""
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Additional numbers or flags by name, shape [N, ...] each; NaN means not measured."""
    hand_file: str = ""
    """TOML file of a hand that is not registered by name."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Models of objects by name, if attached; not written to files."""
    object_bounds: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Lowest and highest corner of the objects' meshes by name, if known, object frame [m], shape [2, 3]."""

    FIELDS: ClassVar = {
        "object_name": ArrayField("name", ("N",)),
        "object_mass": ArrayField("positive", ("N",)),
        "object_pose": ArrayField("pose", ("N", 7)),
        "object_rest_pose": ArrayField("pose", ("N", 7)),
        "wrist_pose": ArrayField("pose", ("N", 7)),
        "joint_positions": ArrayField("number", ("N", "M")),
        "keypoints": ArrayField("number", ("N", "K", 3)),
        "link_contacts": ArrayField("flag", ("N", "L")),
        "task": ArrayField("text", ("N",), optional=True),
        "shown_places": ArrayField("number", ("N", "S", 3), optional=True),
        "shown_normals": ArrayField("number", ("N", "S", 3), optional=True),
    }
    GRASP: ClassVar = RobotGrasp

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "joint_names", tuple(str(name) for name in self.joint_names))
        if not self.hand:
            raise FungraspError("field 'hand' is empty, expected the name of a hand")
        if len(self.joint_names) != self.joint_positions.shape[1]:
            raise FungraspError(
                f"field 'joint_positions' has shape {self.joint_positions.shape}, expected (N, M) with "
                f"M = {len(self.joint_names)}, the length of joint_names"
            )
        if (self.shown_places is None) != (self.shown_normals is None):
            raise FungraspError("give both 'shown_places' and 'shown_normals', or neither")
        if len(set(self.joint_names)) != len(self.joint_names):
            raise FungraspError("field 'joint_names' names a joint twice")
        object.__setattr__(self, "extra", checked_extra(self.extra, len(self)))
        squeeze = self.extra.get(SQUEEZE)
        if squeeze is not None and squeeze.shape != self.joint_positions.shape:
            raise FungraspError(
                f"field 'extra/{SQUEEZE}' has shape {squeeze.shape}, expected {self.joint_positions.shape}, "
                "that of joint_positions"
            )
        distance = np.linalg.norm(self.wrist_pose[:, :3] - self.object_pose[:, :3], axis=-1)
        check_rows(
            "wrist_pose", distance <= MAX_HAND_DISTANCE, "is far from the object; the distance [m]", distance
        )

    @property
    def wrist_pose_object(self) -> np.ndarray:
        """Poses of the palm body, object frame, shape [N, 7]."""
        return compose(invert(self.object_pose), self.wrist_pose)

    def joint_dict(self) -> dict[str, np.ndarray]:
        """Return the joint positions by name [rad], shape [N] each, including coupled joints."""
        return dict(zip(self.joint_names, self.joint_positions.T, strict=True))

    def joints_in_order(self, names: Sequence[str]) -> np.ndarray:
        """Return the joint positions in the order of ``names`` [rad], shape [N, len(names)].

        Raises:
            FungraspError: the hand does not have one of the joints.
        """
        return self.joint_positions[:, _columns(self.joint_names, names)]

    @property
    def object_mass_spread(self) -> np.ndarray | None:
        """Standard deviation of the logarithm of guessed masses, shape [N]; None if masses are known."""
        return self.extra.get(MASS_SPREAD)

    def load_hand(self) -> Hand:
        """Load the hand of the grasps.

        Raises:
            FungraspError: the hand is not found, or its version differs.
        """
        # Importing hands loads MuJoCo, which human grasps do not need.
        from fungrasp.hands import load_hand

        try:
            hand = load_hand(self.hand_file or self.hand)
        except FungraspError as error:
            raise FungraspError(f"the hand '{self.hand}' of the grasps is not found: {error}") from error
        self.check_hand(hand)
        return hand

    def check_hand(self, hand: Hand) -> None:
        """Check that the grasps are for this hand.

        Raises:
            FungraspError: the name, joints or contact links differ.
        """
        if self.hand != hand.name:
            raise FungraspError(f"the grasps are of the hand '{self.hand}', not of '{hand.name}'")
        links = {self.link_contacts.shape[1]}
        if self.shown_places is not None:
            links.add(1 + self.shown_places.shape[1])
        if self.joint_names != hand.joint_names or links != {len(hand.links)}:
            raise FungraspError(
                f"the grasps were made for another version of the hand '{hand.name}': retarget again"
            )

    def _whole_set(self) -> dict[str, Any]:
        return {"hand": self.hand, "joint_names": self.joint_names, "hand_file": self.hand_file}

    def _rows(self, which: Any) -> dict[str, Any]:
        return super()._rows(which) | {"extra": {name: value[which] for name, value in self.extra.items()}}

    @classmethod
    def _whole_of(cls, grasp: RobotGrasp) -> dict[str, Any]:
        extra = {name: np.asarray(value)[None] for name, value in grasp.extra.items()}
        whole = {"hand": grasp.hand, "joint_names": grasp.joint_names, "hand_file": grasp.hand_file}
        return super()._whole_of(grasp) | whole | {"extra": extra}

    def _further_arrays(self) -> dict[str, np.ndarray]:
        whole = {"hand": np.array(self.hand), "joint_names": np.array(self.joint_names, dtype=str)}
        if self.hand_file:
            whole["hand_file"] = np.array(self.hand_file)
        return whole | {EXTRA + name: value for name, value in self.extra.items()}


def _columns(known: Sequence[str], names: Sequence[str]) -> list[int]:
    for name in names:
        if name not in known:
            raise UnknownNameError("joint", name, known)
    return [known.index(name) for name in names]
