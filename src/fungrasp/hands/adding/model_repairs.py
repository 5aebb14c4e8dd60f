"""What is mended in a foreign model first: a palm that is fused with the world, joints that no hand has."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Container, Iterator

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands.checking.findings import Finding, listed, warning

MIN_FINGERS = 2
"""Branches with joints on the world that make it a palm, where no body carries as many."""

WORLD = "world"
"""Name by which the world is chosen as the palm."""

SCENERY = ("plane", "hfield")
"""Types of geoms that are no part of a hand."""


def wrap_world(root: ElementTree.Element, palm: str | None, findings: list[Finding]) -> str | None:
    """Give fingers that stand on the world a body to stand on.

    Args:
        root: of a URDF, or of an MJCF with included files in place; it is changed.
        palm: the body that the user names.
        findings: what was done is added.

    Returns:
        name of the palm, which is the new body where ``palm`` is "world".
    """
    return (_rename_world if root.tag == "robot" else _wrap_world)(root, palm, findings)


def _rename_world(robot: ElementTree.Element, palm: str | None, findings: list[Finding]) -> str | None:
    """MuJoCo takes a link that is called "world" for the world itself."""
    parents = [
        joint.find("parent")
        for joint in robot.findall("joint")
        if joint.get("type") not in ("fixed", "floating")
    ]
    count = sum(parent is not None and parent.get("link") == WORLD for parent in parents)
    if palm not in (None, WORLD) or count < MIN_FINGERS:
        return palm
    links = {link.get("name", ""): link for link in robot.findall("link")}
    name = _new_name(set(links))
    links[WORLD].set("name", name)
    for parent in robot.iter("parent"):
        if parent.get("link") == WORLD:
            parent.set("link", name)
    findings.append(
        warning(f"{count} fingers stand on the link 'world': it is called '{name}', and is the palm")
    )
    return name


def _wrap_world(root: ElementTree.Element, palm: str | None, findings: list[Finding]) -> str | None:
    """Put fingers that stand on the world, and the shapes there, into a body of their own."""
    worlds = root.findall("worldbody")
    children = [(world, child) for world in worlds for child in world]
    fingers = [child for _, child in children if _moves(child)]
    names = {body.get("name") for world in worlds for body in world.iter("body")}
    if palm is not None and (palm != WORLD or WORLD in names):
        return palm
    deep = max((_branches(body) for world in worlds for body in world.iter("body")), default=0)
    if palm is None and (len(fingers) < MIN_FINGERS or deep >= len(fingers)):
        return None
    name = _new_name(names)
    body = ElementTree.Element("body", {"name": name})
    for world, child in children:
        shape = child.tag in ("geom", "site") and child.get("type") not in SCENERY
        if shape or (child.tag in ("body", "frame") and child.find("freejoint") is None):
            world.remove(child)
            body.append(child)
    worlds[0].append(body)
    findings.append(
        warning(
            f"{len(fingers)} fingers stand on the world, so that there is no body to move: they and the "
            f"shapes there were put into a new body '{name}', the palm"
        )
    )
    return name


def _new_name(taken: Container[str | None]) -> str:
    name = "palm"
    while name in taken:
        name += "_"
    return name


def _moves(element: ElementTree.Element) -> bool:
    """Whether a child of a body is the beginning of a branch with joints that is not free itself."""
    return (
        element.tag in ("body", "frame")
        and element.find("freejoint") is None
        and all(joint.get("type") != "free" for joint in element.findall("joint"))
        and any(True for _ in element.iter("joint"))
    )


def _branches(body: ElementTree.Element) -> int:
    return sum(_moves(child) for child in _children(body))


def _children(element: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Children, through frames."""
    for child in element:
        if child.tag == "frame":
            yield from _children(child)
        else:
            yield child


def check_mimics(robot: ElementTree.Element, tied: Container[str], findings: list[Finding]) -> None:
    """Hold joints still that mimic one that is fixed.

    Args:
        robot: root of a URDF; it is changed.
        tied: joints whose couplings the user gives.
        findings: what was done is added.

    Raises:
        FungraspError: a joint mimics one that does not exist.
    """
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        driver = joints.get(mimic.get("joint", ""))
        if name in tied:
            joint.remove(mimic)
        elif driver is None or driver is joint:
            raise FungraspError(
                f"the joint '{name}' mimics '{mimic.get('joint')}', which is no other joint: say what it "
                f"follows with --couple '{name}=OFFSET+SLOPE*DRIVER'"
            )
        elif driver.get("type") == "fixed":
            mimic.set("joint", next(n for n, j in joints.items() if j.get("type") != "fixed" and n != name))
            mimic.set("multiplier", "0")
            words = f"the joint '{name}' mimics '{driver.get('name')}', which is fixed: it is held still"
            findings.append(warning(words))


FINGER_RANGE = (-0.2, 1.6)
"""Proposed for a hinge without limits [rad]: that of a human finger's joint, with some extension."""

LARGEST_RADIANS = 3.5
"""Where no limit is larger, limits that are written as degrees are radians: no finger turns further."""

BALL_RANGE = 0.5
"""Proposed to each side for a ball joint without limits [rad]."""

BALL_TWIST = 0.05
"""Of a ball joint about the line of its link, which rods and tendons keep from turning [rad]."""


def repair_joints(spec: mujoco.MjSpec, findings: list[Finding]) -> None:
    """Name every joint and body, make ball joints three hinges, and give every hinge limits that can be."""
    kinds = mujoco.mjtJoint
    hinges = [np.abs(j.range).max() for j in spec.joints if j.type == kinds.mjJNT_HINGE and np.any(j.range)]
    if spec.compiler.degree and hinges and max(hinges) < LARGEST_RADIANS:
        spec.compiler.degree = False
        findings.append(
            warning(
                f"no hinge turns further than {max(hinges):.3g} degrees as the file is written: its angles "
                'are taken as radians (a <compiler angle="radian"/> is missing)'
            )
        )
    for i, body in enumerate(spec.bodies[1:], start=1):
        body.name = body.name or f"body_{i}"
    for joint in list(spec.joints):
        if joint.type == kinds.mjJNT_FREE:
            spec.delete(joint)
        elif joint.type == kinds.mjJNT_BALL:
            findings.append(_three_hinges(spec, joint))
    taken = {joint.name for joint in spec.joints}
    for joint in spec.joints:
        name = joint.name or f"{joint.parent.name}_joint"
        while not joint.name and name in taken:
            name += "_"
        joint.name = name
        taken.add(name)
    _unwind_wheels(spec, findings)
    _limits(spec, findings)


def _unwind_wheels(spec: mujoco.MjSpec, findings: list[Finding]) -> None:
    """Hold still what turns by more than one turn and carries nothing: wheels of motors."""
    unit = np.pi / 180 if spec.compiler.degree else 1.0
    hinges = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE]
    wide = [j for j in hinges if np.ptp(j.range) * unit > 2 * np.pi + 1e-6]
    tied = {name for equality in spec.equalities for name in (equality.name1, equality.name2)}
    wheels = [j for j in wide if not list(j.parent.bodies) and j.name not in tied and j.parent.parent.name]
    if not wheels or 2 * len(wide) > len(hinges):
        return
    names = [joint.name for joint in wheels]
    for actuator in [a for a in spec.actuators if a.target in names]:
        spec.delete(actuator)
    for joint in wheels:
        spec.delete(joint)
    findings.append(
        warning(
            f"the joint {listed(names)} turns more than once round and carries nothing: no finger, held still"
        )
    )


def _three_hinges(spec: mujoco.MjSpec, ball: mujoco.MjsJoint) -> Finding:
    body, name, place = ball.parent, ball.name or f"{ball.parent.name}_ball", np.array(ball.pos)
    unit = np.pi / 180 if spec.compiler.degree else 1.0
    limit = float(ball.range[1]) * unit
    stated = limit > 0
    if not stated:
        limit = BALL_RANGE
    friction, damping, armature = ball.frictionloss, np.array(ball.damping), ball.armature
    spec.delete(ball)
    # The link's own line is that to the next body.
    ahead = [np.asarray(child.pos) - place for child in body.bodies]
    along = int(np.argmax(np.abs(ahead[0]))) if ahead else 2
    for axis, letter in enumerate("xyz"):
        reach = min(limit, BALL_TWIST) if axis == along else limit
        hinge = body.add_joint(name=f"{name}_{letter}", type=mujoco.mjtJoint.mjJNT_HINGE, pos=place)
        hinge.axis, hinge.range = np.eye(3)[axis], np.array([-reach, reach]) / unit
        hinge.frictionloss, hinge.damping, hinge.armature = friction, damping, armature
    said = "within its cone" if stated else f"within {BALL_RANGE:g} rad, as it has no limit"
    return warning(
        f"the ball joint '{name}' became three hinges, {said}; its twist about the link stays within "
        f"{BALL_TWIST:g} rad"
    )


def _limits(spec: mujoco.MjSpec, findings: list[Finding]) -> None:
    unit = np.pi / 180 if spec.compiler.degree else 1.0
    none, turned, degrees, cut = [], [], [], []
    driven = {equality.name1 for equality in spec.equalities if equality.name2}
    hinges = [np.abs(j.range).max() * unit for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE]
    in_degrees = 2 * sum(widest > 2 * np.pi + 1e-6 for widest in hinges) > len(hinges)
    for joint in spec.joints:
        low, high = np.asarray(joint.range) * unit
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        stated = bool(np.isfinite([low, high]).all()) and low != high
        if not stated:
            # A driven joint takes its limits from its driver's.
            if joint.name not in driven:
                none.append(joint.name)
            low, high = FINGER_RANGE if hinge else (0.0, 0.03)
            if joint.name in driven:
                low, high = -np.pi, np.pi
        if low > high:
            turned.append(joint.name)
            low, high = high, low
        if hinge and stated and in_degrees:
            degrees.append(joint.name)
            low, high = np.radians([low, high])
        if hinge and max(-low, high) > np.pi + 1e-6:
            cut.append(f"{joint.name} {low:.3g} to {high:.3g}")
            low, high = max(low, -np.pi), min(high, np.pi)
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = np.array([low, high]) / unit
    for names, text in (
        (none, f"has no limits; {FINGER_RANGE[0]:g} to {FINGER_RANGE[1]:g} rad are proposed"),
        (turned, "has its limits in the wrong order; turned round"),
        (degrees, "has limits in degrees, as most turn beyond a full turn in radians; taken as degrees"),
        (cut, "turns further than half a turn to a side [rad]: cut to that"),
    ):
        if names:
            findings.append(warning(f"the joint {listed(names)} {text}"))
