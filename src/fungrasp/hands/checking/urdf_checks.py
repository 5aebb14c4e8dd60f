"""Faults seen in the text of a URDF: the tree of links, joint types, effort limits, mimic joints."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator

from fungrasp.hands.checking.finding import Finding, error, listed, warning

_MOVING = ("revolute", "continuous", "prismatic")


def check_urdf(robot: ElementTree.Element) -> Iterator[Finding]:
    """Faults of the links and joints of a URDF; ``robot`` is its root element."""
    links = [link.get("name", "") for link in robot.iterfind("link")]
    joints = list(robot.iterfind("joint"))
    for kind, names in (("link", links), ("joint", [joint.get("name", "") for joint in joints])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            yield error(f"more than one {kind} is named {listed(twice)}")
    yield from _tree(links, joints)
    for joint in joints:
        yield from _joint(joint, {other.get("name", "") for other in joints})
    yield from _inertials(robot, joints)


def _tree(links: list[str], joints: list[ElementTree.Element]) -> Iterator[Finding]:
    children: Counter[str] = Counter()
    for joint in joints:
        name = joint.get("name", "")
        for end in ("parent", "child"):
            element = joint.find(end)
            link = "" if element is None else element.get("link", "")
            if link not in links:
                yield error(f"joint '{name}' names a {end} link '{link}' that does not exist")
            if end == "child":
                children[link] += 1
    several = [link for link, count in children.items() if count > 1]
    if several:
        yield error(f"more than one joint has as its child the link {listed(several)}; a hand must be a tree")
    roots = [link for link in links if not children[link]]
    if len(roots) > 1:
        yield error(
            f"{len(roots)} links have no parent joint: {listed(roots)}; all but the palm's root must hang on "
            "a joint"
        )
    if links and not roots:
        yield error("every link has a parent joint: the chain is a loop with no root")


def _joint(joint: ElementTree.Element, names: set[str]) -> Iterator[Finding]:
    name, kind = joint.get("name", ""), joint.get("type", "")
    if kind in ("floating", "planar"):
        yield error(f"joint '{name}' is {kind}; the joints of a hand must be revolute or fixed")
    if kind not in _MOVING:
        return
    limit = joint.find("limit")
    effort = _number(limit, "effort")
    mimic = joint.find("mimic")
    if mimic is None and not effort:
        yield warning(
            f"joint '{name}' has no force limit (<limit effort>); give force_limit in [actuators] of the "
            "hand's TOML file"
        )
    if mimic is not None:
        driver = mimic.get("joint", "")
        if driver == name or driver not in names:
            yield error(
                f"joint '{name}' mimics '{driver}', {'itself' if driver == name else 'which does not exist'}"
            )
        if _number(mimic, "multiplier") == 0:
            yield warning(f"joint '{name}' mimics '{driver}' with multiplier 0, so it does not move")


def _inertials(robot: ElementTree.Element, joints: list[ElementTree.Element]) -> Iterator[Finding]:
    moved = {
        child.get("link", "")
        for joint in joints
        if joint.get("type") in _MOVING and (child := joint.find("child")) is not None
    }
    bare = [
        link.get("name", "")
        for link in robot.iterfind("link")
        if link.get("name", "") in moved and link.find("inertial") is None
    ]
    if bare:
        yield warning(
            f"no <inertial> in the moving link {listed(bare)}: mass and inertia are computed from the "
            "collision shapes at the density of water; give the true ones"
        )


def _number(element: ElementTree.Element | None, key: str) -> float | None:
    try:
        return None if element is None or element.get(key) is None else float(element.get(key, ""))
    except ValueError:
        return None
