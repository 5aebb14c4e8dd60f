"""Reading a URDF or MJCF: a fault is reported and repaired, so that the rest can be checked too. Of a URDF
also what its text alone tells: the tree of links, joint types, effort limits, mimic joints."""

from __future__ import annotations

import contextlib
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line
from fungrasp.core.formats.mujoco_model import check_model_numbers, read_model, read_model_text
from fungrasp.core.formats.text_files import parse_xml_text
from fungrasp.hands.checking.findings import Finding, error, listed, warning

MESH_FORMATS = (".obj", ".stl", ".msh")


@dataclass(frozen=True)
class ModelSource:
    """A model file, read."""

    path: Path
    """The URDF or MJCF file."""
    spec: mujoco.MjSpec
    """Repaired: without missing meshes, static bodies not fused; compiles to ``model``."""
    model: mujoco.MjModel
    """The compiled ``spec``."""
    fuses: bool
    """As written, bodies with no joint are merged into their parents."""
    urdf: ElementTree.Element | None
    """Root element, if the file is a URDF."""
    stripped: frozenset[str]
    """Bodies that lost shapes with the missing meshes: nothing can be said about their mass and touch."""


def read_source(path: Path, findings: list[Finding]) -> ModelSource | None:
    """Read a model file and add what is wrong to ``findings``. None if nothing beyond that can be checked."""
    root = parse_xml(path, findings)
    if root is None:
        return None
    urdf = root if root.tag == "robot" else None
    if urdf is not None:
        findings.extend(check_urdf(urdf))
    with quiet():
        try:
            spec = read_model(path)
        except ValueError as problem:
            findings.append(error(f"MuJoCo cannot read {path}: {one_line(problem)}"))
            return None
        fuses = bool(spec.compiler.fusestatic)
        stripped = _drop_missing_meshes(spec, findings)
        findings.extend(_joint_kinds(spec))
        findings.extend(_mend_limits(spec))
        findings.extend(_mend_inertias(spec))
        compiler = spec.compiler
        compiler.fusestatic, compiler.balanceinertia, compiler.boundmass, compiler.boundinertia = (
            False,
            True,
            1e-12,
            1e-14,
        )
        try:
            model = spec.compile()
        except ValueError as problem:
            findings.append(error(f"{path} does not compile: {one_line(problem)}"))
            return None
        try:
            check_model_numbers(model, str(path))
        except FungraspError as problem:
            findings.append(error(str(problem)))
            return None
    return ModelSource(path, spec, model, fuses, urdf, stripped)


def parse_xml(
    path: Path, findings: list[Finding], tags: tuple[str, ...] = ("robot", "mujoco")
) -> ElementTree.Element | None:
    """Root element of an XML file; None if it has none of ``tags``, which is added to ``findings``."""
    try:
        text = read_model_text(path)
    except FungraspError as problem:
        findings.append(error(str(problem)))
        return None
    try:
        root = parse_xml_text(_declared(text), str(path))
    except FungraspError as problem:
        findings.append(error(str(problem)))
        return None
    macro = any(
        "xacro" in element.tag or any("${" in value for value in element.attrib.values())
        for element in root.iter()
    )
    if path.suffix == ".xacro" or macro:
        findings.append(
            error(f"{path} is a xacro template; run xacro on it and check the URDF that comes out")
        )
        return None
    if root.tag not in tags:
        findings.append(
            error(f"{path} is neither a URDF (<robot>) nor an MJCF (<mujoco>): its root is <{root.tag}>")
        )
        return None
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


def _drop_missing_meshes(spec: mujoco.MjSpec, findings: list[Finding]) -> frozenset[str]:
    folder = Path(spec.modelfiledir) / spec.compiler.meshdir
    bad: set[str] = set()
    missing: list[str] = []
    unreadable: list[str] = []
    for mesh in spec.meshes:
        if not mesh.file:
            continue
        if not (folder / mesh.file).is_file():
            missing.append(mesh.file)
        elif Path(mesh.file).suffix.lower() not in MESH_FORMATS:
            unreadable.append(mesh.file)
        else:
            continue
        bad.add(mesh.name or Path(mesh.file).stem)
    if missing:
        packages = any(file.startswith("package:") for file in missing)
        hint = (
            " (package:// addresses are not resolved: write paths relative to the file)" if packages else ""
        )
        findings.append(
            error(f"missing mesh {listed(missing)}, looked for in {folder}{hint}; the checks go on without")
        )
    if unreadable:
        findings.append(
            error(f"mesh {listed(unreadable)}: MuJoCo reads {', '.join(MESH_FORMATS)}; convert it")
        )
    stripped = set()
    for geom in list(spec.geoms):
        if geom.meshname in bad:
            stripped.add(geom.parent.name)
            spec.delete(geom)
    for mesh in list(spec.meshes):
        if (mesh.name or Path(mesh.file).stem) in bad:
            spec.delete(mesh)
    return frozenset(stripped)


def _joint_kinds(spec: mujoco.MjSpec) -> Iterator[Finding]:
    kinds = mujoco.mjtJoint
    for joint in spec.joints:
        if joint.type in (kinds.mjJNT_FREE, kinds.mjJNT_BALL):
            word = "free" if joint.type == kinds.mjJNT_FREE else "ball"
            yield error(f"joint '{joint.name}' is a {word} joint; the joints of a hand must be hinges")
        elif joint.type == kinds.mjJNT_SLIDE:
            yield error(f"joint '{joint.name}' slides; the joints of a hand must be hinges")


def _mend_limits(spec: mujoco.MjSpec) -> Iterator[Finding]:
    limited, auto = mujoco.mjtLimited.mjLIMITED_TRUE, mujoco.mjtLimited.mjLIMITED_AUTO
    unlimited, degrees = [], []
    widest = 0.0
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            continue
        lower, upper = np.deg2rad(joint.range) if spec.compiler.degree else np.asarray(joint.range)
        if lower == upper == 0.0:
            unlimited.append(joint.name)
        elif lower == upper:
            yield error(
                f"joint '{joint.name}' has a zero range: both limits are {lower:g} rad; make it fixed or "
                "give its limits"
            )
        elif lower > upper:
            yield error(
                f"joint '{joint.name}' has inverted limits: lower {lower:g} is above upper {upper:g} rad"
            )
        elif max(-lower, upper) > 2 * np.pi + 1e-6:
            degrees.append(f"{joint.name} ({lower:g} to {upper:g})")
        elif joint.limited != limited and not (joint.limited == auto and spec.compiler.autolimits):
            yield error(
                f"joint '{joint.name}' gives a range that is ignored; write limited=\"true\" or "
                'autolimits="true"'
            )
        widest = max(widest, abs(lower), abs(upper))
        if lower >= upper:
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    if unlimited:
        yield error(
            f"no limits (or both are 0) for the joint {listed(unlimited)}; give lower and upper in radians"
        )
    if degrees:
        yield error(
            f"limits beyond a full turn for the joint {listed(degrees)} [rad]: degrees mistaken for radians?"
        )
    if spec.compiler.degree and 0.0 < widest < 0.1:
        yield error(
            f"the widest joint limit is {widest:.3g} rad: radians read as degrees? Add <compiler "
            'angle="radian"/>'
        )


def _mend_inertias(spec: mujoco.MjSpec) -> Iterator[Finding]:
    negative, lopsided = [], []
    for body in spec.bodies:
        if not body.explicitinertial:
            continue
        moments = principal_inertias(body)
        if not body.mass > 0:
            if list(body.joints):
                yield error(f"body '{body.name}' has mass {body.mass:g} kg; it must be positive")
            body.explicitinertial = False
            continue
        if not moments[0] > 0:
            negative.append(f"{body.name} ({_numbers(moments)})")
        elif moments[2] > (moments[0] + moments[1]) * (1 + 1e-3):
            lopsided.append(f"{body.name} ({_numbers(moments)})")
        else:
            radius = float(np.sqrt(moments[2] / body.mass))
            if not 3e-4 < radius < 0.3:
                yield warning(
                    f"body '{body.name}' has a radius of gyration of {1000 * radius:.3g} mm: are its mass "
                    f"({body.mass:g}) and principal inertias ({_numbers(moments)}) in kg and kg m2?"
                )
            continue
        body.fullinertia = [np.nan, 0, 0, 0, 0, 0]
        body.inertia = [body.mass * 1e-4] * 3
    if negative:
        yield error(f"the principal inertias [kg m2] must be positive of the body {listed(negative)}")
    if lopsided:
        yield error(
            f"no mass has the principal inertias [kg m2] of the body {listed(lopsided)}: the largest must "
            "not exceed the sum of the other two"
        )


def principal_inertias(body: mujoco.MjsBody) -> np.ndarray:
    """In rising order [kg m2], shape [3]."""
    diagonal, full = np.asarray(body.inertia), np.asarray(body.fullinertia)
    return np.linalg.eigvalsh(np.diag(diagonal) if np.isnan(full[0]) else _symmetric(full))


def _symmetric(full: np.ndarray) -> np.ndarray:
    """xx, yy, zz, xy, xz, yz to a matrix, shape [3, 3]."""
    xx, yy, zz, xy, xz, yz = full
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's own warnings, those by Python too, from the terminal and from a log file: the findings
    say it better."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        mujoco.set_mju_user_warning(before)


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
