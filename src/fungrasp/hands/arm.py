"""Mount a hand on the flange of a robot arm, and write both as one file."""

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
"""Site of an arm's model at its flange; z points out of the flange."""

PALM_SITE = "mounted_palm"
"""Site that ``mount`` adds at the origin of the palm body."""

MOUNTING_GAP = 0.001
"""Default clearance between the flange and the palm [m]."""

ADAPTER = "hand_adapter"
"""Name of the geom between flange and hand."""

_PREFIX = "mounted/"


@dataclass(frozen=True)
class Mount:
    """Mounting of a hand on a flange. In the hand frame, z points along the fingers and x out of the palm;
    its origin is the middle of the palm's lower end."""

    pose_flange_hand: tuple[float, ...] = ()
    """Pose of the hand frame in the flange frame: position [m] and quaternion wxyz. Empty: ``MOUNTING_GAP``
    above the flange, the palm facing the flange's x axis."""
    adapter_radius: float = 0.0
    """Radius of a cylinder around the flange's z axis that encloses adapter and cables [m]; 0: none."""
    adapter_length: float = 0.0
    """Length of the cylinder from the flange [m]."""


DIRECT = Mount()
"""Mount without an adapter."""


def arm_files() -> dict[str, Path]:
    """Return the model files of the built-in arms by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "arms").glob("*.xml"))}


def arm_spec(arm: str) -> mujoco.MjSpec:
    """Return a new model of a bare arm: base at the world's origin, one actuator per joint with its name.

    Args:
        arm: name of a built-in arm, or an MJCF file (.xml) with the same conventions.

    Raises:
        FungraspError: the arm is unknown, or the file is not a model of an arm.
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
    """Return the pose of the palm body in the flange frame, ``pose_flange_palm`` [m], shape [7]."""
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
    """Return a model of the hand on the flange of an arm, the arm's base at the world's origin.

    Both keep their names, and meshes are stored in the spec. The arm compensates the weight of the palm, as a
    payload known to its controller, but not that of the fingers. ``PALM_SITE`` marks the palm frame.

    Args:
        child: model mounted in place of ``hand.spec()``, for example one with visual meshes.

    Raises:
        UnknownNameError: the arm is unknown.
        FungraspError: the two do not make one model, for example because they share a name.
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
    # Default classes keep the prefix: both models have a class "main".
    return mujoco.MjSpec.from_string(re.sub(f'(?<!class)="{_PREFIX}', '="', self_contained_xml(spec)))


def _palm_bounds(hand: Hand, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of the palm body's geoms along unit vectors [m], shape [3] each; zero without geoms.

    Args:
        rows: unit vectors, palm frame, shape [3, 3].
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
    """Return self-contained MJCF of the hand with one position actuator per independent joint.

    Args:
        arm: arm to mount the hand on, its base at the world's origin. If None, the palm is fixed there.

    Raises:
        UnknownNameError: the arm is unknown.
        FungraspError: the model cannot be written as one file.
    """
    return self_contained_xml(hand.spec() if arm is None else mount(hand, arm))
