"""Faults of the joints of a compiled model: kinds, frames, couplings, actuators."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from fungrasp.hands.checking.finding import Finding, HandParts, error, listed, note, warning
from fungrasp.hands.checking.kinematic_tree import body_name, driven_joints, joint_name
from fungrasp.hands.checking.model_source import ModelSource

FRAME_OFFSET = 1e-3
"""Distance of a link's origin from its joint's axis that is mentioned [m]."""

COUPLING_OVERRUN = 0.02
"""By how much a coupling may push a joint beyond its limit [rad]."""


def check_joints(model: mujoco.MjModel, parts: HandParts) -> Iterator[Finding]:
    """No joints, or link frames that are not on their joint."""
    if model.njnt == 0:
        yield error("the model has no joints")
    links = {body for chain in parts.fingers.values() for body in chain}
    # Bodies whose key point is another one, named in the TOML.
    elsewhere = {body for finger in parts.joints for body in parts.fingers[finger]}
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE):
        body, axis, center = int(model.jnt_bodyid[joint]), model.jnt_axis[joint], model.jnt_pos[joint]
        offset = float(np.linalg.norm(center - (center @ axis) * axis))
        if offset > FRAME_OFFSET and (not links or body_name(model, body) in links - elsewhere):
            yield warning(
                f"the frame of '{body_name(model, body)}' is {1000 * offset:.1f} mm off the axis of its "
                f"joint '{joint_name(model, joint)}'; key points are link origins: put the origin there, or "
                "name sites there as 'joints' of the finger"
            )


def check_couplings(source: ModelSource) -> Iterator[Finding]:
    """Couplings that were dropped, that are not linear, or that break limits."""
    model = source.model
    driven = driven_joints(model)
    names = {joint_name(model, joint) for joint in driven}
    for joint in () if source.urdf is None else source.urdf.iterfind("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("name") not in names:
            slope, constant = mimic.get("multiplier", "1"), mimic.get("offset", "0")
            yield error(
                f"the <mimic> of joint '{joint.get('name')}' was dropped in reading, so it would move "
                "freely; write an MJCF with <equality>"
                f'<joint joint1="{joint.get("name")}" joint2="{mimic.get("joint")}" polycoef="{constant} '
                f'{slope} 0 0 0"/></equality>'
            )
    for joint, equalities in driven.items():
        name = joint_name(model, joint)
        if len(equalities) > 1:
            yield error(f"joint '{name}' is driven by {len(equalities)} joint equalities; only one can hold")
        yield from _coupling(model, joint, equalities[0])
    yield from _loops(model, driven)
    yield from _tendons(model, driven)


def check_actuators(model: mujoco.MjModel) -> Iterator[Finding]:
    """Actuators of a bare model that may push with any force."""
    endless = [
        model.actuator(a).name or f"actuator {a}"
        for a in range(model.nu)
        if not model.actuator_forcelimited[a]
        and not (
            model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
            and model.jnt_actfrclimited[model.actuator_trnid[a, 0]]
        )
    ]
    if endless:
        yield warning(
            f"no force limit on the actuator {listed(endless)}; give forcerange [N m], or force_limit in the "
            "TOML"
        )
    if model.nu == 0:
        yield note(
            "the model has no actuators; [actuators] of the hand's TOML gives every independent joint a "
            "position servo"
        )


def _coupling(model: mujoco.MjModel, joint: int, equality: int) -> Iterator[Finding]:
    name, driver = joint_name(model, joint), int(model.eq_obj2id[equality])
    coefficients = model.eq_data[equality, :5]
    if np.abs(coefficients[2:]).max() > 1e-9:
        yield warning(
            f"joint '{name}' follows '{joint_name(model, driver)}' by a curve; retargeting uses only its "
            f"straight part, {coefficients[0]:g} + {coefficients[1]:g} * driver"
        )
    if coefficients[1] == 0.0:
        yield warning(
            f"joint '{name}' is coupled to '{joint_name(model, driver)}' with slope 0, so it does not move"
        )
    if model.qpos0[model.jnt_qposadr[[joint, driver]]].any():
        yield warning(f"the coupling of '{name}' counts from the reference (ref) of its joints; make ref 0")
    if not (model.jnt_limited[joint] and model.jnt_limited[driver]):
        return
    ends = np.polynomial.polynomial.polyval(model.jnt_range[driver], coefficients)
    lower, upper = model.jnt_range[joint]
    overrun = max(lower - ends.min(), ends.max() - upper)
    if overrun > COUPLING_OVERRUN:
        yield warning(
            f"'{joint_name(model, driver)}' drives joint '{name}' from {ends.min():.3f} to {ends.max():.3f} "
            f"rad, beyond its limits {lower:.3f} to {upper:.3f}"
        )


def _loops(model: mujoco.MjModel, driven: dict[int, list[int]]) -> Iterator[Finding]:
    for joint in driven:
        seen, current = [joint], int(model.eq_obj2id[driven[joint][0]])
        while current in driven and current not in seen:
            seen.append(current)
            current = int(model.eq_obj2id[driven[current][0]])
        if current == joint == min(seen):
            yield error(
                f"the couplings of the joint {listed([joint_name(model, j) for j in seen])} form a loop"
            )


def _tendons(model: mujoco.MjModel, driven: dict[int, list[int]]) -> Iterator[Finding]:
    for tendon in range(model.ntendon):
        span = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if not (model.wrap_type[span] == mujoco.mjtWrap.mjWRAP_JOINT).all():
            continue
        joints = [int(joint) for joint in model.wrap_objid[span]]
        if len(joints) > 1 and not set(joints) & set(driven):
            yield warning(
                f"tendon '{model.tendon(tendon).name}' couples the joint "
                f"{listed([joint_name(model, j) for j in joints])}; fungrasp sees only joint equalities: "
                "they count as independent"
            )
