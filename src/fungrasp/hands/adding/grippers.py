"""Grippers, which can't imitate a hand: they are told apart and refused."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands.adding.couplings import Coupling
from fungrasp.hands.adding.finger_chains import Chain, chain_joints
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.checking.finding import listed
from fungrasp.hands.checking.kinematic_tree import body_name, joint_name, subtree

PARALLEL = 0.95
"""Cosine of the angle between axes that are parallel."""


def refuse_sliding_or_one_motor(model: mujoco.MjModel, palm: int, couplings: list[Coupling]) -> None:
    """Refuse what slides or moves as one.

    Raises:
        FungraspError: a joint below the palm slides, or one motor moves them all.
    """
    below = set(subtree(model, palm)) - {palm}
    joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in below]
    slides = [joint_name(model, j) for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE]
    if slides:
        raise FungraspError(
            f"the joint {listed(slides)} slides, as in a gripper with jaws; the fingers of a hand must turn "
            "on hinges"
        )
    motors = {a for a in range(model.nu) if set(_driven(model, a)) & set(joints)}
    free = set(joints) - {coupling.joint for coupling in couplings}
    if len(motors) == 1 or len(free) == 1:
        raise FungraspError(
            f"'{body_name(model, palm)}' carries a gripper: one motor moves its {len(joints)} joints; a hand "
            "needs a thumb and fingers that move by themselves"
        )


def refuse_jaws(poses: Poses, chains: list[Chain]) -> None:
    """Refuse two fingers that move in one plane, and several that one or two motors move in planes that are
    parallel.

    Raises:
        FungraspError: they do.
    """
    joints = [j for chain in chains for j in chain_joints(poses.model, chain)]
    motors = int(np.any(poses.matrix[joints], axis=0).sum())
    axes = np.array([poses.axis(j) for j in joints])
    if np.abs(axes @ axes[0]).min() > PARALLEL and (len(chains) == 2 or motors <= 2):
        raise FungraspError(
            f"'{body_name(poses.model, poses.palm)}' carries a gripper: its {len(joints)} joints are all "
            "parallel; a hand needs a thumb that moves across the fingers"
        )


def _driven(model: mujoco.MjModel, actuator: int) -> list[int]:
    """Joints that an actuator moves, by itself or over a tendon."""
    target = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_TENDON:
        return [target]
    start = model.tendon_adr[target]
    span = slice(start, start + model.tendon_num[target])
    return model.wrap_objid[span][model.wrap_type[span] == mujoco.mjtWrap.mjWRAP_JOINT].tolist()
