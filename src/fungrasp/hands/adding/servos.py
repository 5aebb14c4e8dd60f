"""Torque limits, gains, armature, damping and friction of joints: the file's if plausible, else proposed."""

from __future__ import annotations

import json
from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.hands.adding.finger_chains import driven_joints
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.adding.structure import HandStructure
from fungrasp.hands.findings import Finding, listed, warning
from fungrasp.hands.kinematic_tree import ancestors, joint_name

TIP_FORCE = 10.0
"""Strong tip force of a robot finger [N], by the data sheets of Shadow and Inspire."""

BELIEVABLE = (0.25, 3.0)
"""Plausible range of the median ratio between a file's torque limits and the torques for ``TIP_FORCE``."""

POSSIBLE = (0.05, 20.0)
"""Plausible range of this ratio for a single joint: a thumb's base may be ten times as strong as needed."""

FULL_TORQUE_ERROR = 0.2
"""Position error at which a servo reaches its torque limit [rad]."""

LEAST_TORQUE = 0.05
"""Smallest proposed torque limit, for joints that move no tip [N m]."""


@dataclass(frozen=True)
class JointPhysics:
    """Physics of all joints of the new model, shape [M] each. Servo values apply to independent joints."""

    force_limit: np.ndarray
    """Torque limits [N m]."""
    kp: np.ndarray
    """Stiffness [N m/rad]."""
    kd: np.ndarray
    """Servo damping [N m s/rad]."""
    armature: np.ndarray
    """Armature [kg m^2]."""
    damping: np.ndarray
    """Joint damping [N m s/rad]."""
    frictionloss: np.ndarray
    """Dry friction [N m]."""


def joint_physics(
    poses: Poses, structure: HandStructure, tips: dict[str, np.ndarray], findings: list[Finding]
) -> JointPhysics:
    """Return the physics of the joints; values that differ from the file's are added to the findings.

    Args:
        tips: fingertips by finger, frame of the last link [m], shape [3].
    """
    model = poses.model
    proposed = np.maximum(TIP_FORCE * _levers(poses, structure, tips), LEAST_TORQUE)
    stated = _stated_limits(model)
    for j, driver in enumerate(np.argmax(np.abs(poses.matrix) > 0, axis=1)):
        # A motor may sit on a driven joint.
        if not poses.matrix[j, driver]:
            continue
        own = poses.independent[driver]
        stated[own] = min(stated[own], stated[j] * abs(poses.matrix[j, driver]))
    inside = np.array([_in_hand(model, structure.palm, j) for j in range(model.njnt)], dtype=bool)
    independent = inside & np.isin(np.arange(model.njnt), poses.independent)
    said = independent & np.isfinite(stated)
    ratio = stated / proposed
    sound = said.any() and BELIEVABLE[0] <= np.median(ratio[said]) <= BELIEVABLE[1]
    believed = (ratio >= POSSIBLE[0]) & (ratio <= POSSIBLE[1]) & sound
    force = np.where(believed, stated, proposed)
    unsaid, wrong = independent & ~said, said & ~believed
    reason = f"proposed: the torque for {TIP_FORCE:g} N at the tip of the half bent finger"
    if unsaid.any():
        findings.append(warning(f"no torque limit for {_named(model, unsaid)}: {reason}"))
    if wrong.any():
        changes = [
            f"{joint_name(model, j)} {stated[j]:.3g} to {proposed[j]:.2g}" for j in np.flatnonzero(wrong)
        ]
        more = f" and {len(changes) - 6} more" if len(changes) > 6 else ""
        findings.append(
            warning(f"implausible torque limits were changed [N m]: {', '.join(changes[:6])}{more}; {reason}")
        )
    kp = force / FULL_TORQUE_ERROR
    armature, damping = model.dof_armature.copy(), model.dof_damping.copy()
    friction = model.dof_frictionloss.copy()
    # This servo has a natural frequency of 45 rad/s: stable at steps of 5 ms, and about critically damped.
    light = inside & ((armature < 1e-4 * kp) | (armature > 0.01 * kp))
    armature[light] = np.maximum(5e-4 * kp[light], 5e-4)
    slack = inside & ((damping < 2e-3 * kp) | (damping > 0.2 * kp))
    damping[slack] = 0.01 * kp[slack]
    dry = inside & ((friction <= 0) | (friction > 0.2 * force))
    friction[dry] = 0.01 * force[dry]
    for name, mask, values, unit, why in (
        ("armature", light, armature, "kg m2", "so that servos are stable at steps of 5 ms"),
        ("damping", slack, damping, "N m s/rad", "a hundredth of the servo's stiffness"),
        ("friction", dry, friction, "N m", "a hundredth of the torque limit"),
    ):
        if mask.any():
            low, high = f"{values[mask].min():.2g}", f"{values[mask].max():.2g}"
            proposed = low if low == high else f"{low} to {high}"
            findings.append(
                warning(
                    f"{name} is zero or implausible for {_named(model, mask)}: proposed {proposed} {unit}, "
                    f"{why}"
                )
            )
    return JointPhysics(force, kp, 0.03 * kp, armature, damping, friction)


def _levers(poses: Poses, structure: HandStructure, tips: dict[str, np.ndarray]) -> np.ndarray:
    """Return the largest motion of a tip per radian of each joint, with half bent fingers [m/rad], shape [M].
    The joint moves with all joints that it drives; a driven joint has the value of its driver."""
    half = 0.5 * (poses.start + poses.high)
    poses.set(half)
    at = {n: poses.of_body(c.bodies[-1], tips[n]) for n, c in structure.fingers.items()}
    levers = np.zeros(poses.matrix.shape[1])
    for u in range(len(levers)):
        step = half.copy()
        step[u] += 1e-4
        poses.set(step)
        for name, chain in structure.fingers.items():
            moved = poses.of_body(chain.bodies[-1], tips[name]) - at[name]
            levers[u] = max(levers[u], float(np.linalg.norm(moved)) / 1e-4)
    drivers = np.argmax(np.abs(poses.matrix) > 0, axis=1)
    return levers[drivers]


def _stated_limits(model: mujoco.MjModel) -> np.ndarray:
    """Return the file's torque limits [N m], shape [M]; infinite for joints without one."""
    limits = np.full(model.njnt, np.inf)
    given = model.jnt_actfrclimited.astype(bool) & (np.abs(model.jnt_actfrcrange).max(axis=1) > 0)
    limits[given] = np.abs(model.jnt_actfrcrange[given]).max(axis=1)
    for a in range(model.nu):
        motor = (
            model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
        )
        force = np.inf
        if model.actuator_forcelimited[a]:
            force = np.abs(model.actuator_forcerange[a]).max()
        elif motor and model.actuator_ctrllimited[a]:
            force = abs(model.actuator_gainprm[a, 0]) * np.abs(model.actuator_ctrlrange[a]).max()
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
            first = model.tendon_adr[model.actuator_trnid[a, 0]]
            if model.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT:
                # The lever of a spatial tendon depends on the pose.
                continue
        joints = driven_joints(model, a)
        if force > 0:
            limits[joints] = np.minimum(limits[joints], force * abs(model.actuator_gear[a, 0]))
    return limits


def shared_motors(poses: Poses, palm: int) -> Finding | None:
    """Return a warning if a hand with motors has joints without their own motor, else None."""
    model = poses.model
    joints = [j for j in range(model.njnt) if _in_hand(model, palm, j)]
    free = {int(u) for u in np.flatnonzero(np.abs(poses.matrix[joints]).sum(axis=0))}
    rows = [driven_joints(model, a) for a in range(model.nu)]
    moved = [set(np.flatnonzero(np.abs(poses.matrix[r]).sum(axis=0)).tolist()) & free for r in rows]
    motors = [columns for columns in moved if columns]
    idle = free - set().union(*motors)
    if not motors or (not idle and len(motors) >= len(free)):
        return None
    names = [joint_name(model, poses.independent[u]) for u in sorted(idle)]
    return warning(
        f"{len(motors)} motors move {len(free)} joints"
        + (f", none of them {listed(names)}" if names else "")
        + ": each joint gets its own servo, unlike the real hand; tie joints that move together with "
        "--couple JOINT=OFFSET+SLOPE*DRIVER"
    )


def _in_hand(model: mujoco.MjModel, palm: int, joint: int) -> bool:
    return palm in ancestors(model, int(model.jnt_bodyid[joint]))[1:]


def _named(model: mujoco.MjModel, mask: np.ndarray) -> str:
    return f"joint {listed([joint_name(model, j) for j in np.flatnonzero(mask)], limit=3)}"


def servo_entries(physics: JointPhysics, poses: Poses, joints: list[int]) -> tuple[list[str], list[str]]:
    """Return the lines of the TOML tables [actuators], the most frequent servo, and [actuators.joints].

    Args:
        joints: joints of the hand, including driven ones.
    """
    joints = [j for j in joints if j in poses.independent]

    def entry(j: int) -> tuple[str, str, str]:
        return f"{physics.kp[j]:.3g}", f"{physics.kd[j]:.3g}", f"{physics.force_limit[j]:.3g}"

    entries = [entry(j) for j in joints]
    common = max(dict.fromkeys(entries), key=entries.count)
    lines = [
        f"kp = {common[0]} # N m/rad",
        f"kd = {common[1]} # N m s/rad",
        f"force_limit = {common[2]} # N m",
    ]
    special = [
        f"{json.dumps(joint_name(poses.model, j))} = {{ kp = {kp}, kd = {kd}, force_limit = {force} }}"
        for j, (kp, kd, force) in zip(joints, entries, strict=True)
        if (kp, kd, force) != common
    ]
    return lines, special
