"""Conversion of human grasps: conventions, rest poses, hands below the table, mirrored grasps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import (
    invert,
    quaternion_conjugate,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.grasps.grasp_set import BOUNDS
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import hand_sides, joint_order, mirror_points, mirror_pose
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import settled_up
from fungrasp.objects.object_variants import mirrored_name, mirrored_object

Unit = Literal["m", "dm", "inch", "cm", "mm"]

POSES = ("object_pose", "object_rest_pose")

UNITS: dict[Unit, float] = {"m": 1.0, "dm": 0.1, "inch": 0.0254, "cm": 0.01, "mm": 0.001}
"""Meters per unit."""

_HALF = np.sqrt(0.5)
UP = {
    "z": (1.0, 0.0, 0.0, 0.0),
    "y": (_HALF, _HALF, 0.0, 0.0),
    "-y": (_HALF, -_HALF, 0.0, 0.0),
    "x": (_HALF, 0.0, -_HALF, 0.0),
    "-x": (_HALF, 0.0, _HALF, 0.0),
    "-z": (0.0, 1.0, 0.0, 0.0),
}
"""Rotation (wxyz) from each upward axis to z."""

BELOW_TABLE = -0.01
"""Joints below this height above the table top [m] are measurement errors."""


@dataclass(frozen=True)
class Convention(CheckedRecord):
    """Conventions of human grasps. The defaults are those of fungrasp."""

    joint_order: str = "fungrasp"
    """Joint order: fungrasp, openpose, mediapipe, mano and others (``fungrasp.grasps.human_hand.ORDERS``)."""
    unit: Unit = "m"
    """Unit of the joints, and of object positions if ``object_unit`` is "same"."""
    object_unit: Literal["same", "m", "dm", "inch", "cm", "mm"] = "same"
    """Unit of object positions."""
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    """Order of quaternions."""
    rotation: Literal["as-is", "transposed"] = "as-is"
    """"transposed": rotations act on row vectors (v R), so they are inverted."""
    pose: Literal["object-in-world", "world-in-object"] = "object-in-world"
    """Frames of the object poses."""
    joints_frame: Literal["world", "object"] = "world"
    """Frame of the joints."""
    up: Literal["z", "y", "-y", "x", "-x", "-z"] = "z"
    """Upward axis of the world."""
    table_height: float = 0.0
    """Height of the table top along the upward axis [m]."""
    side: Literal["right", "left"] = "right"
    """"left": mirror hands and objects in the plane y = 0; object names then end in "_mirrored"."""
    rest_pose: Literal["given", "settled"] = "given"
    """"settled": compute rest poses from the held poses (``settled_pose``)."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is unknown, or the height is not finite.
        """
        super().__post_init__()
        joint_order(self.joint_order)

    @property
    def changes(self) -> dict[str, str | float]:
        """Values that differ from the defaults, by name."""
        return {f.name: v for f in fields(self) if (v := getattr(self, f.name)) != f.default}

    def as_options(self) -> str:
        """Return the options of ``fungrasp grasps convert`` for this convention."""
        return " ".join(f"--{name.replace('_', '-')} {_text(v)}" for name, v in self.changes.items())

    def as_arguments(self) -> str:
        """Return the arguments of ``Convention`` for this convention."""
        return ", ".join(
            f'{name}="{v}"' if isinstance(v, str) else f"{name}={_text(v)}"
            for name, v in self.changes.items()
        )


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def converted(arrays: Mapping[str, np.ndarray], convention: Convention) -> dict[str, np.ndarray]:
    """Convert fields of human grasps to the conventions of fungrasp.

    Missing fields are not computed. Joint rotations (``hand_qpos``) are dropped if they would change.

    Args:
        arrays: fields of ``HumanGraspSet`` by name.

    Raises:
        FungraspError: a field has a wrong shape or type, the convention has another type, or it declares
            right hands as left ones.
    """
    if not isinstance(convention, Convention):
        raise FungraspError(f'expected a Convention, such as Convention(unit="mm"), not {convention!r}')
    for name, shape in {"hand_joints": (21, 3), **dict.fromkeys(POSES, (7,))}.items():
        array = arrays.get(name)
        if array is not None and (array.shape[1:] != shape or array.dtype.kind not in "fiu"):
            sizes = ", ".join(map(str, shape))
            found = f"{array.dtype} of shape {array.shape}"
            raise FungraspError(f"field '{name}' holds {found}, expected numbers of shape (N, {sizes})")
    result = dict(arrays)
    scale = UNITS[convention.unit]
    object_scale = scale if convention.object_unit == "same" else UNITS[convention.object_unit]
    joints = arrays["hand_joints"][:, joint_order(convention.joint_order)] * scale
    turn = np.array(UP[convention.up])
    down = np.array([0.0, 0.0, convention.table_height])
    poses = {name: _our_pose(arrays[name], convention, object_scale) for name in POSES if name in arrays}
    if convention.joints_frame == "object":
        joints = transform_points(poses["object_pose"], joints)
    joints = rotate(turn, joints) - down
    for name, pose in poses.items():
        turned = quaternion_multiply(turn, pose[:, 3:])
        result[name] = np.concatenate([rotate(turn, pose[:, :3]) - down, turned], axis=1)
    if convention.side == "left":
        joints = mirror_points(joints)
        right = hand_sides(joints) == "left"
        if 2 * right.sum() > len(right):
            raise FungraspError(
                f"side is left, but the fingers of {right.sum()} of {len(right)} hands bend as those of "
                "right hands: leave it out"
            )
        result |= {name: mirror_pose(result[name]) for name in poses}
        names = arrays["object_name"].astype(str)
        result["object_name"] = np.array([mirrored_name(str(name)) for name in names])
        result = {name: array for name, array in result.items() if not name.startswith(BOUNDS)}
    result["hand_joints"] = joints
    if convention.rest_pose == "settled":
        result.pop("object_rest_pose", None)
    if set(convention.changes) - {"quaternion", "rotation", "pose", "object_unit", "rest_pose"}:
        result.pop("hand_qpos", None)
    return result


def _our_pose(pose: np.ndarray, convention: Convention, scale: float) -> np.ndarray:
    pose = pose.astype(float)
    pose = np.concatenate([pose[:, :3] * scale, pose[:, 3:]], axis=1)
    if convention.quaternion == "xyzw":
        pose = pose[:, [0, 1, 2, 6, 3, 4, 5]]
    if convention.rotation == "transposed":
        pose = pose * [1, 1, 1, 1, -1, -1, -1]
    if convention.pose == "world-in-object":
        pose = invert(pose)
    return pose


def settled_pose(
    pose: np.ndarray,
    model: ObjectModel,
    face: Callable[[ObjectModel, np.ndarray], np.ndarray] = settled_up,
) -> np.ndarray:
    """Return the pose of an object after it is put down vertically, on the stable face nearest to downwards.

    Args:
        pose: pose before, world frame, shape [7].
        face: function for the upward direction on that face: ``settled_up`` or ``broad_settled_up``.

    Returns:
        World frame, shape [7].
    """
    up = rotate(quaternion_conjugate(pose[3:]), np.array([0.0, 0.0, 1.0]))
    standing = face(model, up)
    tilt = np.cross(standing, up)
    angle = np.arctan2(np.linalg.norm(tilt), standing @ up)
    axis = tilt / max(np.linalg.norm(tilt), 1e-12)
    turn = quaternion_multiply(pose[3:], quaternion_from_rotation_vector(axis * angle))
    lowest = rotate(turn, model.hull.reshape(-1, 3))[:, 2].min()
    return np.concatenate([pose[:2], [-lowest], turn])


def mend_below_table(grasps: HumanGraspSet, how: Literal["keep", "lift", "drop"]) -> HumanGraspSet:
    """Keep or drop grasps with a hand below the table, or lift them, with the object, out of the table."""
    depth = np.minimum(grasps.hand_joints[..., 2].min(axis=1, initial=np.inf), 0.0)
    below = depth < BELOW_TABLE
    if how == "keep" or not below.any():
        return grasps
    if how == "drop":
        return grasps.select(~below)
    up = np.where(below, -depth, 0.0)[:, None] * [0.0, 0.0, 1.0]
    pose, qpos = grasps.object_pose.copy(), grasps.hand_qpos
    pose[:, :3] += up
    if qpos is not None:
        qpos = np.concatenate([qpos[:, :3] + up, qpos[:, 3:]], axis=1)
    return replace(grasps, object_pose=pose, hand_joints=grasps.hand_joints + up[:, None], hand_qpos=qpos)


def mirrored_grasps(grasps: HumanGraspSet) -> HumanGraspSet:
    """Reflect grasps and objects in the world's plane y = 0.

    An object ``mug`` becomes ``mug_mirrored``, which ``fungrasp.objects.load_object`` knows, and vice versa.
    ``hand_qpos`` is dropped, since the angles of a left hand describe other rotations.
    """
    return replace(
        grasps,
        object_name=np.array([mirrored_name(str(name)) for name in grasps.object_name]),
        object_pose=mirror_pose(grasps.object_pose),
        object_rest_pose=mirror_pose(grasps.object_rest_pose),
        hand_joints=mirror_points(grasps.hand_joints),
        hand_qpos=None,
        objects={mirrored_name(name): mirrored_object(model) for name, model in grasps.objects.items()},
        object_bounds={
            mirrored_name(name): np.sort(corners * [1.0, -1.0, 1.0], axis=0)
            for name, corners in grasps.object_bounds.items()
        },
    )
