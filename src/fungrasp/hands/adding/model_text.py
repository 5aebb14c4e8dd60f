"""The text of a foreign URDF or MJCF, with included files in place and a palm that is a body of its own."""

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
"""Files that a model may include."""

MIN_FINGERS = 2
"""Branches with joints on the world that make it a palm, where no body carries as many."""

WORLD = "world"
"""Name by which the world is chosen as the palm."""

SCENERY = ("plane", "hfield")
"""Types of geoms that are no part of a hand."""


def parse_xml(path: Path, tags: tuple[str, ...] = ("robot", "mujoco")) -> ElementTree.Element:
    """Root element of a model file.

    Raises:
        FungraspError: it can't be read, is a template, or its root has none of ``tags``.
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
    """Declare the prefixes of names that a file for other tools leaves undeclared, as most readers allow."""
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
    """Make MuJoCo keep visual meshes, static links and paths of a URDF."""
    for old in robot.findall("mujoco"):
        robot.remove(old)
    settings = {"discardvisual": "false", "fusestatic": "false", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", settings)


def inline_includes(root: ElementTree.Element, folder: Path) -> None:
    """Put included files in place of the ``<include>`` elements, and find those of attached models."""
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
