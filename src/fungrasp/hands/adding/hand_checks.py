"""Checks of a hand folder: TOML file, model, fingers and shapes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.mujoco_model import quiet, read_model
from fungrasp.core.formats.text_files import read_toml
from fungrasp.hands.adding.couplings import find_couplings
from fungrasp.hands.adding.model_file import read_foreign
from fungrasp.hands.adding.poses import narrowed_ranges
from fungrasp.hands.collisions import (
    BY_SHAPE,
    SelfContact,
    exclusion,
    self_contacts,
    zero_and_random_poses,
)
from fungrasp.hands.findings import Finding, error, listed, warning
from fungrasp.hands.hand import Hand, read_hand_toml, side_of
from fungrasp.hands.kinematic_tree import (
    ancestors,
    body_name,
    carrier_of,
    drives,
    joint_name,
    place_of,
    subtree,
)
from fungrasp.hands.kinematics import FARTHEST, palm_offset
from fungrasp.hands.plausibility import check_plausibility

LEAST_OVERLAP = 5e-4
"""Smallest reported overlap of collision shapes at the zero pose [m]."""

LARGE_OVERLAP = 3e-3
"""Largest overlap at the zero pose that is not an error [m]."""

FRAME_OFFSET = 1e-3
"""Largest unreported distance of a link's origin from its joint's axis [m]."""

FAR_ORIGIN = 0.02
"""Largest unreported excess of the palm origin's distance from the fingers over ``FARTHEST`` [m]."""

SHORTEST_LINK = 1e-3
"""Key points of a finger nearer than this coincide [m]."""


def check_hand(path: Path) -> list[Finding]:
    """Check a hand's TOML file and model. Without errors, the hand can be used."""
    findings: list[Finding] = []
    hand = None
    with quiet():
        try:
            read = read_hand_toml(path)
            hand = read if read.model.njnt and read.coupling else None
        except FungraspError as problem:
            findings.append(error(str(problem)))
        findings += _faults_of_model(path, hand is not None)
    if hand is not None:
        findings += [*_joints(hand), *_palm(hand), *_fingers(hand)]
        if not any(finding.severity == "error" for finding in findings):
            findings += [*_shapes(hand), *check_plausibility(hand), *_side(hand)]
    return findings


def _faults_of_model(path: Path, loads: bool) -> Iterator[Finding]:
    """Report faults that ``hands add`` would repair: as errors, since loading a hand does not repair them."""
    try:
        data = read_toml(path, "hand file")
        if "palm_frame" not in data:
            yield warning("[palm_frame] is missing: fingers along z and a palm facing x are assumed")
        file, palm = path.parent / str(data["model"]), str(data["palm"])
        foreign = read_foreign(file, palm)
        couplings = find_couplings(foreign.model, foreign.findings)
        fuses = not loads and read_model(file).compiler.fusestatic
    except (FungraspError, KeyError) as problem:
        # If the hand does not load, its error is reported already.
        if loads:
            yield error(str(problem))
        return
    for finding in foreign.findings:
        say = error if finding.severity == "warning" else warning
        yield say(f"{finding.message} (only 'fungrasp hands add' does this)")
    yield from narrowed_ranges(foreign.model, couplings)
    if fuses:
        yield error(
            f"the palm '{palm}' is fused with the world when the file is read, so that it has no body of its "
            'own: write <compiler fusestatic="false"/> (in a URDF inside <mujoco> inside <robot>), or let '
            "'fungrasp hands add FILE' write an MJCF"
        )


def _joints(hand: Hand) -> Iterator[Finding]:
    """Report joints that are not hinges, have no limits or lie off their link's frame; unusual couplings."""
    model = hand.model
    kinds = {int(mujoco.mjtJoint.mjJNT_SLIDE): "slides", int(mujoco.mjtJoint.mjJNT_BALL): "is a ball joint"}
    kinds[int(mujoco.mjtJoint.mjJNT_FREE)] = "is a free joint"
    # The frame of a link is free if the TOML file names another key point.
    links = {
        link for f in hand.fingers.values() for link, at in zip(f.links, f.joints, strict=True) if link == at
    }
    for joint, kind in enumerate(model.jnt_type.tolist()):
        body, name = body_name(model, model.jnt_bodyid[joint]), joint_name(model, joint)
        if kind in kinds:
            yield error(f"joint '{name}' {kinds[kind]}; the joints of a hand must be hinges")
            continue
        if not model.jnt_limited[joint]:
            yield error(f"joint '{name}' has no valid limits: give them in radians")
        center, axis = model.jnt_pos[joint], model.jnt_axis[joint]
        offset = float(np.linalg.norm(center - (center @ axis) * axis))
        if offset > FRAME_OFFSET and body in links:
            yield warning(
                f"the frame of '{body}' is {1e3 * offset:.1f} mm off the axis of its joint '{name}'; key "
                "points are link origins: put the origin there, or name sites there as 'joints' of the finger"
            )
    for joint, drive in drives(model).items():
        name, driver = joint_name(model, joint), joint_name(model, drive.driver)
        if drive.slope == 0.0:
            yield warning(f"joint '{name}' is coupled to '{driver}' with slope 0, so it does not move")
        if model.qpos0[model.jnt_qposadr[[joint, drive.driver]]].any():
            yield warning(
                f"the coupling of '{name}' is relative to the reference (ref) of its joints: set ref to 0"
            )


def _palm(hand: Hand) -> Iterator[Finding]:
    """Report a palm that is fused with the world, that moves, or whose origin is far from the fingers."""
    model = hand.model
    on_world = int((model.geom_bodyid == 0).sum())
    if on_world:
        yield error(
            f"{on_world} shapes belong to the world and not to a body: the palm is fused with the world; put "
            'its shapes and the fingers in a <body name="palm">'
        )
    above = ancestors(model, model.body(hand.palm).id)
    movers = [joint_name(model, j) for j in range(model.njnt) if int(model.jnt_bodyid[j]) in above]
    if movers:
        yield error(
            f"the palm '{hand.palm}' moves on the joint {listed(movers)}; fungrasp moves the palm itself: "
            "remove the joint"
        )
    bases = [finger.joints[0] for name, finger in hand.fingers.items() if name != "thumb"]
    excess = float(np.linalg.norm(palm_offset(model, hand.palm, bases)))
    if excess > FAR_ORIGIN:
        yield warning(
            f"the origin of the palm '{hand.palm}' lies {excess + FARTHEST:.2f} m from the bases of the "
            "fingers, outside the hand: grasps store the pose of that point; the start of the lift test uses "
            "a point near the fingers"
        )


def _side(hand: Hand) -> Iterator[Finding]:
    seen = side_of(hand.model, hand.palm, hand.fingers, np.cross(hand.palm_fingers, hand.palm_normal))
    if seen != hand.side:
        yield warning(
            f'side is "{hand.side}", but by the order of its fingers, seen from the palm, this is a {seen} '
            "hand"
        )


def _fingers(hand: Hand) -> Iterator[Finding]:
    """Report fingers that are not a chain from the palm to the tip."""
    model, data = hand.model, mujoco.MjData(hand.model)
    mujoco.mj_kinematics(model, data)
    owners: dict[str, str] = {}
    for name, finger in hand.fingers.items():
        for link in finger.links:
            if owners.setdefault(link, name) != name or finger.links.count(link) > 1:
                yield error(f"the body '{link}' is named twice: in finger '{owners[link]}' and in '{name}'")
        for near, far in pairwise((hand.palm, *finger.links)):
            inner, outer = model.body(near).id, model.body(far).id
            if inner in ancestors(model, outer):
                if model.body_weldid[inner] == model.body_weldid[outer]:
                    yield error(
                        f"finger '{name}': no joint between '{near}' and '{far}', so they are one link"
                    )
            elif outer in ancestors(model, inner):
                yield error(
                    f"finger '{name}': '{far}' is nearer to the palm than '{near}'; list links from base to "
                    "tip"
                )
            else:
                yield error(f"finger '{name}' is not one chain: '{far}' does not hang on '{near}'")
        carrier, last = carrier_of(model, finger.tip), model.body(finger.links[-1]).id
        if last not in ancestors(model, carrier):
            yield error(
                f"finger '{name}': the tip '{finger.tip}' is on the body '{body_name(model, carrier)}', not "
                f"on the last link '{finger.links[-1]}'"
            )
        elif model.body_weldid[carrier] != model.body_weldid[last]:
            yield error(
                f"finger '{name}': a joint moves the tip '{finger.tip}' against the last link "
                f"'{finger.links[-1]}'"
            )
        for near, far in pairwise((*finger.joints, finger.tip)):
            if np.linalg.norm(place_of(data, far) - place_of(data, near)) < SHORTEST_LINK:
                yield error(
                    f"finger '{name}': '{near}' and '{far}' are at the same point; leave out '{near}', or "
                    "move the tip to the link's end"
                )


def _shapes(hand: Hand) -> Iterator[Finding]:
    """Report links without collision shapes, and shapes that overlap at the zero pose or in many poses."""
    model = hand.model
    solid = set(model.geom_bodyid[(model.geom_contype != 0) | (model.geom_conaffinity != 0)].tolist())
    links = {model.body(link).id: link for finger in hand.fingers.values() for link in finger.links}
    bare = [link for body, link in links.items() if not solid & _owned(model, body, links)]
    if bare:
        yield error(f"no collision shape on the link {listed(bare)}: it can't touch anything")
    poses = zero_and_random_poses(model)
    at_zero = self_contacts(model, poses[:1], LEAST_OVERLAP)
    seen = {(contact.first, contact.second) for contact in at_zero}
    often = [
        contact
        for contact in self_contacts(model, poses[1:])
        if contact.share > BY_SHAPE and (contact.first, contact.second) not in seen
    ]
    for contacts in _by_finger(model, links, hand, at_zero):
        say = error if contacts[0].depth > LARGE_OVERLAP else warning
        yield say(_overlap(contacts, "at the zero pose"))
    for contacts in _by_finger(model, links, hand, often):
        share = max(contact.share for contact in contacts)
        yield warning(_overlap(contacts, f"in {100 * share:.0f} % of all poses, and therefore in grasps"))


def _owned(model: mujoco.MjModel, link: int, links: Iterable[int]) -> set[int]:
    """Return the bodies fixed to a link and those below it that are not below another link."""
    hanging = {b for b in subtree(model, link) if next(a for a in ancestors(model, b) if a in links) == link}
    return hanging | set(np.flatnonzero(model.body_weldid == model.body_weldid[link]).tolist())


def _by_finger(
    model: mujoco.MjModel, links: dict[int, str], hand: Hand, contacts: list[SelfContact]
) -> list[list[SelfContact]]:
    """Group contacts by the pair of fingers, the deepest first."""
    owner = {link: name for name, finger in hand.fingers.items() for link in finger.links}

    def finger(name: str) -> str:
        above = ancestors(model, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
        return next((owner[links[body]] for body in above if body in links), "palm")

    groups: dict[tuple[str, ...], list[SelfContact]] = {}
    for contact in sorted(contacts, key=lambda contact: -contact.depth):
        groups.setdefault(tuple(sorted((finger(contact.first), finger(contact.second)))), []).append(contact)
    return list(groups.values())


def _overlap(contacts: list[SelfContact], when: str) -> str:
    """Return the message for contacts of two fingers, the deepest first."""
    pairs = ", ".join(f"'{contact.first}' and '{contact.second}'" for contact in contacts[:4])
    more = f", and {len(contacts) - 4} more pairs of these fingers" if len(contacts) > 4 else ""
    return (
        f"the shapes of {pairs}{more} overlap by up to {1e3 * contacts[0].depth:.1f} mm {when}: "
        f"{exclusion(contacts[0].first, contacts[0].second)}"
    )
