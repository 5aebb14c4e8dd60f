"""A hand mounted on the flange of a robot arm, and written as one file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.geometry.poses import compose
from fungrasp.hands.export import self_contained_xml
from fungrasp.hands.hand import Hand

FLANGE_SITE = "tool0"
"""Site of an arm's model where a hand is mounted; z points out of the flange."""

PALM_SITE = "mounted_palm"
"""Site that ``mount`` puts at the origin of the palm body."""

MOUNTING_GAP = 0.001
"""Clearance between the flange and the palm where nobody says how the hand is mounted [m]."""

ADAPTER = "hand_adapter"
"""Shape between flange and hand."""

_PREFIX = "mounted/"


@dataclass(frozen=True)
class Mount:
    """How a hand is fixed to a flange. The hand's frame here: z along the fingers, x out of the palm, its
    origin in the middle of the palm's lower end."""

    pose_flange_hand: tuple[float, ...] = ()
    """Pose of that frame on the flange, whose z axis points out of it: meters and a quaternion wxyz. Empty:
    ``MOUNTING_GAP`` above the flange, the palm facing the flange's x axis."""
    adapter_radius: float = 0.0
    """Radius of a cylinder that adapter and cables fit into, around the flange's z axis [m]; 0: none."""
    adapter_length: float = 0.0
    """Its length from the flange [m]."""


DIRECT = Mount()
"""Of a hand without an adapter."""


def arm_files() -> dict[str, Path]:
    """Model of every arm we ship, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "arms").glob("*.xml"))}


def arm_spec(arm: str) -> mujoco.MjSpec:
    """A fresh model of a bare arm: base at the world's origin, one position actuator per joint, named as it.

    Args:
        arm: name of one that we ship, or an MJCF file (.xml) of another one with the same conventions.

    Raises:
        FungraspError: no such arm, or the file is no model of one.
    """
    if not arm.endswith(".xml"):
        if arm not in arm_files():
            raise UnknownNameError("arm", arm, arm_files())
        return mujoco.MjSpec.from_file(str(arm_files()[arm]))
    if not Path(arm).is_file():
        raise FungraspError(f"there is not a model of an arm '{arm}'")
    try:
        spec = mujoco.MjSpec.from_file(arm)
        spec.copy().compile()
    except ValueError as error:
        raise FungraspError(f"{arm} is not a model of an arm: {' '.join(str(error).split())}") from error
    if spec.site(FLANGE_SITE) is None:
        raise FungraspError(f"{arm}: the site '{FLANGE_SITE}' is missing, where a hand is mounted")
    joints = [joint.name for joint in spec.joints]
    if [actuator.name for actuator in spec.actuators] != joints:
        raise FungraspError(
            f"{arm}: an arm has one actuator for each joint, in their order and with their names"
        )
    return spec


def mounting_pose(hand: Hand, mount: Mount = DIRECT) -> np.ndarray:
    """Pose of the palm body on a flange whose z axis points out of it.

    Args:
        mount: of the hand on the flange.

    Returns:
        ``pose_flange_palm``, shape [7].
    """
    z = hand.palm_fingers
    x = hand.palm_normal - (hand.palm_normal @ z) * z
    x = x / np.linalg.norm(x)
    rows = np.stack([x, np.cross(z, x), z])
    lower, upper = _palm_bounds(hand, rows)
    position = -np.array([*(0.5 * (lower + upper))[:2], lower[2]])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rows.ravel())
    given = mount.pose_flange_hand or (0.0, 0.0, MOUNTING_GAP, 1.0, 0.0, 0.0, 0.0)
    return compose(np.array(given), np.concatenate([position, quaternion]))


def mount(
    hand: Hand, arm: str = "ur5e", how: Mount = DIRECT, child: mujoco.MjSpec | None = None
) -> mujoco.MjSpec:
    """The hand on the flange of an arm, the arm's base at the world's origin.

    Names of both stay as they are; meshes are held in the spec itself. The weight of the palm is compensated
    by the arm (as a payload known to its controller), that of the fingers is not. A site ``PALM_SITE`` marks
    the frame of the palm body. child: what is mounted in place of ``hand.spec()``, one that looks better.

    Raises:
        UnknownNameError: no such arm.
        FungraspError: the hand and the arm don't make one model, for example because they share a name.
    """
    spec = arm_spec(arm)
    mounted: mujoco.MjSpec = child or hand.spec()
    palm = mounted.body(hand.palm)
    palm.gravcomp = 1.0
    palm.add_site(name=PALM_SITE, size=[0.001, 0, 0])
    pose = mounting_pose(hand, how)
    flange = spec.site(FLANGE_SITE)
    if how.adapter_radius > 0:
        half = 0.5 * how.adapter_length
        flange.parent.add_geom(
            name=ADAPTER,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[how.adapter_radius, half, 0],
            pos=compose(np.array([*flange.pos, *flange.quat]), np.array([0, 0, half, 1, 0, 0, 0]))[:3],
            quat=flange.quat,
            mass=0,
        )
    frame = flange.parent.add_frame(pos=pose[:3], quat=pose[3:])
    spec.attach(mounted, prefix=_PREFIX, frame=frame)
    # Default classes keep the prefix, since both models have a class "main"; all else gets its name back.
    return mujoco.MjSpec.from_string(re.sub(f'(?<!class)="{_PREFIX}', '="', self_contained_xml(spec)))


def _palm_bounds(hand: Hand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extent of the palm body's shapes [m] along unit vectors of the palm frame.

    rows: the unit vectors, shape [3, 3]. Returns lower and upper end, each of shape [3].
    """
    model = hand.model
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.flatnonzero(model.geom_bodyid == model.body(hand.palm).id):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        rotation = rotation.reshape(3, 3)
        center = rows @ (model.geom_pos[geom] + rotation @ model.geom_aabb[geom, :3])
        half = np.abs(rows @ rotation) @ model.geom_aabb[geom, 3:]
        lower, upper = np.minimum(lower, center - half), np.maximum(upper, center + half)
    if not np.isfinite(lower).all():
        return np.zeros(3), np.zeros(3)
    return lower, upper


def export_hand(hand: Hand, arm: str | None = None) -> str:
    """MJCF of the hand with one position actuator per independent joint; it needs no other file.

    Args:
        hand: what to write; its palm is fixed at the world's origin.
        arm: name of an arm to mount the hand on; then the arm's base is at the world's origin.

    Raises:
        UnknownNameError: no such arm.
        FungraspError: the model can't be written as one file.
    """
    return self_contained_xml(hand.spec() if arm is None else mount(hand, arm))
