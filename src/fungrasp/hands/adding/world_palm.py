"""Models whose fingers stand on the world, as where a tool has fused the palm with it: they get a palm."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Container, Iterator

from fungrasp.hands.checking.finding import Finding, warning

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
