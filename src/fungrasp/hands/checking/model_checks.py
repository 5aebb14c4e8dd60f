"""Checks of a model's bodies and joints."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from fungrasp.hands.checking.findings import Finding, HandParts, error, listed, note, warning
from fungrasp.hands.checking.model_source import ModelSource
from fungrasp.hands.collisions import BY_SHAPE, self_contacts, zero_and_random_poses
from fungrasp.hands.kinematic_tree import (
    ancestors,
    body_name,
    coupled_positions,
    driven_joints,
    joint_name,
    subtree,
)

LEAST_OVERLAP = 5e-4
"""Overlap of collision shapes that is mentioned [m]."""

LARGE_OVERLAP = 3e-3
"""Overlap at the zero pose that is an error [m]."""


def check_palm(source: ModelSource, parts: HandParts) -> Iterator[Finding]:
    """Is the palm a body of its own, fixed, at the origin of the world?"""
    model = source.model
    on_world = np.flatnonzero(model.geom_bodyid == 0)
    if len(on_world):
        yield error(
            f"{len(on_world)} shapes belong to the world and not to a body: the palm is fused with the "
            "world; "
            'put its shapes and the fingers in a <body name="palm">'
        )
    if parts.palm is None:
        return
    palm = model.body(parts.palm).id
    movers = [
        joint_name(model, j)
        for body in ancestors(model, palm)
        for j in np.flatnonzero(model.jnt_bodyid == body)
    ]
    if movers:
        yield error(
            f"the palm '{parts.palm}' moves on the joint {listed(movers)}; fungrasp moves the palm itself: "
            "remove the joint"
        )
        return
    if source.fuses:
        how = (
            'write <mujoco><compiler fusestatic="false"/></mujoco> inside <robot>'
            if source.urdf is not None
            else 'remove fusestatic="true"'
        )
        yield error(
            f"the palm '{parts.palm}' is fused with the world when the file is read, so that it has no body "
            f"of its own: {how}, or let 'fungrasp hands add FILE' write an MJCF"
        )
    above = ancestors(model, palm)[1:]
    if above:
        stand = listed([body_name(model, body) for body in above])
        yield note(f"the palm '{parts.palm}' is not the root: it stands on {stand}")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    angle = 2 * np.arccos(min(1.0, abs(data.xquat[palm, 0])))
    shift = float(np.linalg.norm(data.xpos[palm]))
    if angle > 1e-3 or shift > 1e-4:
        yield note(
            f"the palm '{parts.palm}' is not at the world's origin in its file: {1000 * shift:.1f} mm away "
            f"and turned by {np.degrees(angle):.1f} degrees; wrist poses are those of the palm body itself"
        )


def check_masses(source: ModelSource) -> Iterator[Finding]:
    """Moving bodies with no mass."""
    model = source.model
    empty = [
        body_name(model, body)
        for body in np.flatnonzero(model.body_jntnum > 0)
        if model.body_mass[model.body_weldid == body].sum() < 1e-6 and not _stripped(source, body)
    ]
    if empty:
        yield error(f"no mass in the moving body {listed(empty)}: give an inertial, or shapes with a mass")


def check_shapes(source: ModelSource, parts: HandParts) -> Iterator[Finding]:
    """Links with nothing to touch with, and shapes that overlap at the zero or the middle pose or in many."""
    model = source.model
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    links = [body for chain in parts.fingers.values() for body in chain]
    bare = [
        name
        for name in links
        if not any(_stripped(source, model.body_weldid[body]) for body in _owned(model, name, links))
        and not collides[np.isin(model.geom_bodyid, _owned(model, name, links))].any()
    ]
    if bare:
        yield error(f"no collision shape on the link {listed(bare)}: it can't touch anything")
    elif not links and not collides.any() and not source.stripped:
        yield error("the model has no collision shapes: it can't touch anything")
    yield from _overlaps(source, parts)


def _overlaps(source: ModelSource, parts: HandParts) -> Iterator[Finding]:
    """Shapes that overlap, a finding for each pair of fingers."""
    model = source.model
    reported: set[tuple[str, str]] = set()
    for pose, positions in (("zero", _zero(model)), ("middle", _middle(model))):
        found = overlapping_shapes(model, positions)
        found = {pair: depth for pair, depth in found.items() if pair not in reported}
        reported |= set(found)
        for pairs in _by_finger(model, parts, found).values():
            deepest = max(found[pair] for pair in pairs)
            say = error if pose == "zero" and deepest > LARGE_OVERLAP else warning
            yield say(
                f"the shapes of {_pairs(pairs)} overlap by {_millimeters(deepest, pairs)} at the {pose} "
                f"pose; shrink them, or if they may, write {_exclude(pairs)}"
            )
    if not source.stripped and model.nq == model.njnt and np.all(model.jnt_limited):
        contacts = {
            (contact.first, contact.second): contact
            for contact in self_contacts(model, zero_and_random_poses(model)[1:])
            if contact.share > BY_SHAPE and (contact.first, contact.second) not in reported
        }
        for pairs in _by_finger(model, parts, {pair: c.depth for pair, c in contacts.items()}).values():
            deepest = max(contacts[pair].depth for pair in pairs)
            share = max(contacts[pair].share for pair in pairs)
            yield warning(
                f"the shapes of {_pairs(pairs)} penetrate each other by up to {1000 * deepest:.1f} mm in "
                f"{100 * share:.0f} % of all poses, so that they will in grasps; shrink them, or if they "
                f"may, write {_exclude(pairs)}"
            )


Pairs = list[tuple[str, str]]


def _by_finger(
    model: mujoco.MjModel, parts: HandParts, depths: dict[tuple[str, str], float]
) -> dict[tuple[str, ...], Pairs]:
    """Pairs of bodies, the deepest first, by the fingers that they belong to."""
    fingers = {model.body(link).id: name for name, links in parts.fingers.items() for link in links}

    def finger(name: str) -> str:
        above = ancestors(model, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
        return next((fingers[body] for body in above if body in fingers), "palm")

    groups: dict[tuple[str, ...], Pairs] = {}
    for pair in sorted(depths, key=lambda pair: -depths[pair]):
        groups.setdefault(tuple(sorted(map(finger, pair))), []).append(pair)
    return groups


def _pairs(pairs: Pairs) -> str:
    words = f"'{pairs[0][0]}' and '{pairs[0][1]}'"
    others = [f"'{first}' and '{second}'" for first, second in pairs[1:4]]
    more = f", and {len(pairs) - 4} more pairs of these fingers" if len(pairs) > 4 else ""
    return ", ".join([words, *others]) + more


def _millimeters(depth: float, pairs: Pairs) -> str:
    return f"{'' if len(pairs) == 1 else 'up to '}{1000 * depth:.1f} mm"


def _exclude(pairs: Pairs) -> str:
    """What lets a pair pass through each other. pairs: the first is named."""
    each = "" if len(pairs) == 1 else " for each pair, as"
    first, second = pairs[0]
    return f'{each} <contact><exclude body1="{first}" body2="{second}"/></contact>'.strip()


def overlapping_shapes(model: mujoco.MjModel, positions: np.ndarray) -> dict[tuple[str, str], float]:
    """Pairs of bodies whose collision shapes overlap by more than ``LEAST_OVERLAP``.

    Args:
        positions: of all joints, shape [nq].

    Returns:
        Deepest overlap by pair of body names [m].
    """
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    deepest: dict[tuple[str, str], float] = {}
    for contact in data.contact:
        first, second = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)
        pair = body_name(model, first), body_name(model, second)
        deepest[pair] = max(deepest.get(pair, 0.0), -float(contact.dist))
    return {pair: depth for pair, depth in deepest.items() if depth > LEAST_OVERLAP}


def check_size(model: mujoco.MjModel, parts: HandParts) -> Iterator[Finding]:
    """A hand in millimeters."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = model.body(parts.palm).id if parts.palm else 0
    reach = max(
        (float(np.linalg.norm(data.xpos[b] - data.xpos[root])) for b in subtree(model, root)), default=0.0
    )
    if reach > 0.6 or 0.0 < reach < 0.03:
        yield warning(f"the farthest link is {reach:.3g} m from the palm; is the model in meters?")


def _zero(model: mujoco.MjModel) -> np.ndarray:
    positions = model.qpos0.copy()
    hinges = np.flatnonzero(model.jnt_limited)
    address = model.jnt_qposadr[hinges]
    positions[address] = np.clip(0.0, *model.jnt_range[hinges].T)
    return coupled_positions(model, positions)


def _middle(model: mujoco.MjModel) -> np.ndarray:
    positions = model.qpos0.copy()
    hinges = np.flatnonzero(model.jnt_limited)
    positions[model.jnt_qposadr[hinges]] = model.jnt_range[hinges].mean(axis=1)
    return coupled_positions(model, positions)


def _stripped(source: ModelSource, weld: int | np.integer) -> bool:
    """Has a body lost shapes, of those that move with the body ``weld``?"""
    members = np.flatnonzero(source.model.body_weldid == weld)
    return any(source.model.body(int(body)).name in source.stripped for body in members)


def _owned(model: mujoco.MjModel, link: str, links: list[str]) -> list[int]:
    """Bodies that belong to a link: what is fixed to it, and what hangs on it and on no other link."""
    body = model.body(link).id
    others = {model.body(other).id for other in links} - {body}
    hanging = {
        member
        for member in subtree(model, body)
        if next(above for above in ancestors(model, member) if above == body or above in others) == body
    }
    return sorted(hanging | set(np.flatnonzero(model.body_weldid == model.body_weldid[body]).tolist()))


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
