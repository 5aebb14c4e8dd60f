"""A hand on a robot arm: mounting it on the flange, and the arm's inverse kinematics."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.errors import UnknownNameError
from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_conjugate,
    quaternion_multiply,
    rotation_vector,
)
from fungrasp.hands.hand import Hand
from fungrasp.hands.mjcf import self_contained_xml

FLANGE_SITE = "tool0"
"""Site of an arm's model where a hand is mounted; z points out of the flange."""

PALM_SITE = "mounted_palm"
"""Site that ``mount`` puts at the origin of the palm body."""

MOUNTING_GAP = 0.001
"""Clearance between the flange and the palm [m]."""

_PREFIX = "mounted/"


def arm_files() -> dict[str, Path]:
    """Model of every arm we ship, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "arms").glob("*.xml"))}


def arm_spec(arm: str) -> mujoco.MjSpec:
    """A fresh model of a bare arm: base at the world's origin, one position actuator per joint, named as it.

    Raises:
        UnknownNameError: no such arm.
    """
    if arm not in arm_files():
        raise UnknownNameError("arm", arm, arm_files())
    return mujoco.MjSpec.from_file(str(arm_files()[arm]))


def mounting_pose(hand: Hand) -> np.ndarray:
    """Pose of the palm body on a flange whose z axis points out of it.

    The fingers point along the flange's z axis and the palm faces its x axis; the shapes of the palm are
    centred on the z axis and begin ``MOUNTING_GAP`` above the flange.

    Returns:
        ``pose_flange_palm``, shape [7].
    """
    z = hand.palm_fingers
    x = hand.palm_normal - (hand.palm_normal @ z) * z
    x = x / np.linalg.norm(x)
    rows = np.stack([x, np.cross(z, x), z])
    lower, upper = _palm_bounds(hand, rows)
    position = -np.array([*(0.5 * (lower + upper))[:2], lower[2] - MOUNTING_GAP])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rows.ravel())
    return np.concatenate([position, quaternion])


def mount(hand: Hand, arm: str = "ur5e") -> mujoco.MjSpec:
    """The hand on the flange of an arm, the arm's base at the world's origin.

    Names of both are kept; meshes are held in the spec itself. The weight of the palm is compensated by the
    arm (as a payload known to its controller), that of the fingers is not. A site ``PALM_SITE`` marks the
    frame of the palm body.

    Raises:
        UnknownNameError: no such arm.
        FungraspError: the hand and the arm don't make one model, for example because they share a name.
    """
    spec = arm_spec(arm)
    child = hand.spec()
    palm = child.body(hand.palm)
    palm.gravcomp = 1.0
    palm.add_site(name=PALM_SITE, size=[0.001, 0, 0])
    body = hand.model.body(hand.palm).id
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    pose_hand_palm = np.concatenate([data.xpos[body], data.xquat[body]])
    pose_flange_hand = compose(mounting_pose(hand), invert(pose_hand_palm))
    flange = spec.site(FLANGE_SITE)
    frame = flange.parent.add_frame(pos=pose_flange_hand[:3], quat=pose_flange_hand[3:])
    spec.attach(child, prefix=_PREFIX, frame=frame)
    # Default classes keep the prefix, since both models have a class "main"; all else gets its name back.
    return mujoco.MjSpec.from_string(re.sub(f'(?<!class)="{_PREFIX}', '="', self_contained_xml(spec)))


def arm_inverse_kinematics(
    model: mujoco.MjModel,
    pose_world_palm: np.ndarray,
    start: np.ndarray,
    iterations: int = 200,
    tolerance: float = 1e-5,
) -> tuple[np.ndarray, float, float]:
    """Angles of the arm that bring the palm to a pose: damped least squares, step

    ``dq = J^T (J J^T + lambda I)^-1 e`` with ``lambda = 1e-3 |e|^2 + 1e-6`` and e the stacked position [m]
    and rotation [rad] error, within the joint limits.

    Args:
        model: compiled from ``mount``.
        pose_world_palm: wanted pose of the palm body, shape [7].
        start: angles of the arm's joints to begin from [rad], shape [A], in model order.
        iterations: at most this many steps.
        tolerance: stop when the norm of the error is below.

    Returns:
        Angles of the arm's joints [rad], shape [A]; remaining position error [m] and rotation error [rad].
    """
    site = model.site(PALM_SITE).id
    joints = arm_joints(model)
    dofs, addresses = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    lower, upper = model.jnt_range[joints].T
    data = mujoco.MjData(model)
    angles = np.clip(np.asarray(start, dtype=float), lower, upper)
    jacobian_position, jacobian_rotation = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    best = (angles, np.inf, np.inf)
    for _ in range(iterations + 1):
        data.qpos[addresses] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        error = _pose_error(data, site, pose_world_palm)
        norms = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if np.hypot(*norms) < np.hypot(*best[1:]):
            best = (angles, *norms)
        if np.hypot(*norms) < tolerance:
            break
        mujoco.mj_jacSite(model, data, jacobian_position, jacobian_rotation, site)
        jacobian = np.concatenate([jacobian_position[:, dofs], jacobian_rotation[:, dofs]])
        damping = (1e-3 * error @ error + 1e-6) * np.eye(6)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping, error)
        angles = np.clip(angles + step, lower, upper)
    return best


def arm_joints(model: mujoco.MjModel) -> np.ndarray:
    """Ids of the joints between the world and the mounted palm, base to flange, shape [A]."""
    body, joints = int(model.site(PALM_SITE).bodyid[0]), []
    while body:
        first = int(model.body_jntadr[body])
        joints.extend(range(first, first + int(model.body_jntnum[body])) if first >= 0 else ())
        body = int(model.body_parentid[body])
    return np.array(sorted(joints), dtype=int)


def _pose_error(data: mujoco.MjData, site: int, pose: np.ndarray) -> np.ndarray:
    """Position then rotation-vector error, world frame, shape [6]."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, data.site_xmat[site])
    rotation = rotation_vector(
        quaternion_multiply(np.asarray(pose[3:], dtype=float), quaternion_conjugate(quaternion))
    )
    return np.concatenate([pose[:3] - data.site_xpos[site], rotation])


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
        centre = rows @ (model.geom_pos[geom] + rotation @ model.geom_aabb[geom, :3])
        half = np.abs(rows @ rotation) @ model.geom_aabb[geom, 3:]
        lower, upper = np.minimum(lower, centre - half), np.maximum(upper, centre + half)
    if not np.isfinite(lower).all():
        return np.zeros(3), np.zeros(3)
    return lower, upper
