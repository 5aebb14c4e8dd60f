"""Preprocess the XML of a foreign URDF or MJCF: includes, mimic joints, and a palm fused with the world."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Container, Iterator
from pathlib import Path

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.mujoco_model import read_model_text
from fungrasp.core.formats.text_files import parse_xml_text
from fungrasp.hands.findings import Finding, warning

MAX_INCLUDES = 100
"""Largest number of included files."""

MIN_FINGERS = 2
"""Smallest number of moving branches with which the world is the palm, if no body carries as many."""

WORLD = "world"
"""Name of the world as the palm."""

SCENERY = ("plane", "hfield")
"""Types of geoms that are not part of a hand."""


def parse_xml(path: Path, tags: tuple[str, ...] = ("robot", "mujoco")) -> ElementTree.Element:
    """Return the root element of a model file.

    Raises:
        FungraspError: the file cannot be read, is a xacro template, or its root tag is not in ``tags``.
    """
    root = parse_xml_text(_declared(read_model_text(path)), str(path))
    macro = any(
        "xacro" in element.tag or any("${" in value for value in element.attrib.values())
        for element in root.iter()
    )
    if path.suffix == ".xacro" or macro:
        raise FungraspError(f"{path} is a xacro template; run xacro on it and take the URDF that comes out")
    if root.tag not in tags:
        raise FungraspError(
            f"{path} is neither a URDF (<robot>) nor an MJCF (<mujoco>): its root is <{root.tag}>"
        )
    return root


def _declared(text: str) -> str:
    """Declare undeclared namespace prefixes, which most other readers accept."""
    bare = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    used = set(re.findall(r"</?([A-Za-z_][\w.-]*):", bare)) | set(
        re.findall(r"\s([A-Za-z_][\w.-]*):[\w.-]+\s*=", bare)
    )
    declared = {"xml", "xmlns", *re.findall(r"xmlns:([\w.-]+)\s*=", bare)}
    added = "".join(f' xmlns:{prefix}="urn:{prefix}"' for prefix in sorted(used - declared))
    return (
        re.sub(r"<(robot|mujoco|mujocoinclude)(?=[\s>/])", rf"<\1{added}", text, count=1) if added else text
    )


def keep_everything(robot: ElementTree.Element) -> None:
    """Make MuJoCo keep visual meshes, static links and mesh paths of a URDF."""
    for old in robot.findall("mujoco"):
        robot.remove(old)
    settings = {"discardvisual": "false", "fusestatic": "false", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", settings)


def inline_includes(root: ElementTree.Element, folder: Path) -> None:
    """Replace ``<include>`` elements by the files' contents, and make paths of attached models absolute."""
    for asset in root.iter("model"):
        file = folder / asset.get("file", "")
        read_model_text(file)
        asset.set("file", str(file.absolute()))
    read = 0
    pending = [root]
    while pending:
        parent = pending.pop()
        for i in range(len(parent) - 1, -1, -1):
            child = parent[i]
            if child.tag != "include":
                pending.append(child)
                continue
            read += 1
            file = folder / child.get("file", "")
            if read > MAX_INCLUDES:
                raise FungraspError(f"more than {MAX_INCLUDES} files are included")
            included = parse_xml(file, ("mujoco", "mujocoinclude"))
            parent.remove(child)
            for offset, element in enumerate(included):
                parent.insert(i + offset, element)
            pending.append(parent)
            break


def wrap_world(root: ElementTree.Element, palm: str | None, findings: list[Finding]) -> str | None:
    """Give fingers that are attached to the world a palm body.

    Args:
        root: root of a URDF, or of an MJCF without includes; it is modified.
        palm: palm given by the user.
        findings: changes are added.

    Returns:
        Name of the given or new palm; None if neither exists.
    """
    return (_rename_world if root.tag == "robot" else _wrap_world)(root, palm, findings)


def _rename_world(robot: ElementTree.Element, palm: str | None, findings: list[Finding]) -> str | None:
    """Rename a link "world" that carries fingers: MuJoCo would fuse it with the world."""
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
    """Move fingers and shapes that are attached to the world into a new body."""
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
    """Return whether an element is the root of a branch with joints, without a free joint."""
    return (
        element.tag in ("body", "frame")
        and element.find("freejoint") is None
        and all(joint.get("type") != "free" for joint in element.findall("joint"))
        and any(True for _ in element.iter("joint"))
    )


def _branches(body: ElementTree.Element) -> int:
    return sum(_moves(child) for child in _children(body))


def _children(element: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Yield the children, and those of frames in their place."""
    for child in element:
        if child.tag == "frame":
            yield from _children(child)
        else:
            yield child


def check_mimics(robot: ElementTree.Element, tied: Container[str], findings: list[Finding]) -> None:
    """Fix joints that mimic a fixed joint, and remove mimics that the user replaces.

    Args:
        robot: root of a URDF; it is modified.
        tied: joints whose couplings the user gives.
        findings: changes are added.

    Raises:
        FungraspError: a joint mimics itself or an unknown joint.
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
