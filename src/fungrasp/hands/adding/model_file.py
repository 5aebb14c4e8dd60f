"""Read a foreign URDF or MJCF with its meshes, and repair it; repairs are reported."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import mujoco
import numpy as np
import trimesh

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line
from fungrasp.core.formats.mesh_file import read_mesh
from fungrasp.core.formats.mujoco_model import check_model_numbers, parse_model, quiet
from fungrasp.hands.adding.model_repairs import drop_bad_inertias, find_palm, name_bodies, repair_joints
from fungrasp.hands.adding.model_text import (
    check_mimics,
    inline_includes,
    keep_everything,
    parse_xml,
    wrap_world,
)
from fungrasp.hands.findings import Finding, listed, note, warning
from fungrasp.hands.kinematic_tree import subtree

MAX_PARENTS = 4
"""Number of folders above the model's in which meshes are searched for."""

DENSITY = 1000.0
"""MuJoCo's default density, for shapes without a mass [kg/m^3]."""

LARGEST_LINK = 1.0
"""Meshes whose median size is larger are in millimeters [m]."""

LARGEST_ALONE = 3.0
"""A single mesh that is larger is in millimeters [m]: no link is smaller than 3 mm."""

LONGEST = 10.0
"""Largest coordinate or size of a hand with its arm [m]."""


@dataclass(frozen=True)
class MeshShape:
    """The mesh of one geom."""

    vertices: np.ndarray
    """Vertices, body frame [m], shape [V, 3]."""
    faces: np.ndarray
    """Indices of vertices, shape [F, 3]."""
    collides: bool
    """Whether it is a collision or visual mesh."""
    rgba: np.ndarray
    """Color, shape [4]."""
    mass: float
    """Mass [kg]; NaN if unknown."""


@dataclass(frozen=True)
class ForeignModel:
    """A model with its meshes apart."""

    model: mujoco.MjModel
    """Model without meshes: static bodies are not fused, and every hinge has limits."""
    meshes: dict[int, list[MeshShape]]
    """Meshes by body id."""
    stripped: frozenset[int]
    """Ids of bodies with a missing or unreadable collision mesh."""
    massless: frozenset[int]
    """Ids of bodies without a valid mass, by inertial or shapes."""
    palm: str | None = None
    """Name of the palm body, if known."""
    findings: list[Finding] = field(default_factory=list)
    """Faults, repairs and assumptions."""


Carriers = dict[mujoco.MjsGeom, tuple[np.ndarray, np.ndarray, bool, float]]
"""Vertices [m], faces, whether it collides, and mass [kg] by the geom that keeps the pose."""


def read_foreign(path: Path, palm: str | None = None, tied: Sequence[str] = ()) -> ForeignModel:
    """Read a URDF or MJCF.

    Args:
        palm: palm body, if known; "world" if the fingers are attached to the world.
        tied: joints whose couplings the user gives.

    Raises:
        FungraspError: the file cannot be read, or the palm cannot be determined.
    """
    findings: list[Finding] = []
    root = parse_xml(path)
    if root.tag == "robot":
        check_mimics(root, tied, findings)
        keep_everything(root)
    else:
        inline_includes(root, path.parent)
    palm = wrap_world(root, palm, findings)
    with quiet():
        spec = _spec(path, root, findings)
        name_bodies(spec)
        wanted = _palm_and_fingers(spec, palm)
        for geom in [g for g in spec.geoms if g.meshname and g.parent.name not in wanted]:
            spec.delete(geom)
        carriers, stripped = _take_meshes(spec, path.parent, root.tag == "robot", findings)
        _let_pictures_collide(spec, carriers, wanted, findings)
        repair_joints(spec, findings)
        massless = drop_bad_inertias(spec, findings)
        total_mass, spec.compiler.settotalmass = max(spec.compiler.settotalmass, 0.0), -1.0
        for actuator in list(spec.actuators):
            # Only the limits of actuators are used, and those of other types may not compile alone.
            if actuator.trntype not in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_TENDON):
                spec.delete(actuator)
        things_to_see = (spec.cameras, spec.lights, spec.textures, spec.hfields, spec.skins)
        for things in (spec.sensors, spec.keys, *things_to_see):
            for obj in list(things):
                spec.delete(obj)
        for material in spec.materials:
            material.textures = [""] * len(material.textures)
        compiler = spec.compiler
        compiler.fusestatic = compiler.discardvisual = False
        compiler.balanceinertia, compiler.boundmass, compiler.boundinertia = True, 1e-9, 1e-12
        try:
            model = spec.compile()
        except (ValueError, mujoco.FatalError) as problem:
            raise FungraspError(f"{path} does not compile: {one_line(problem)}") from problem
    check_model_numbers(model, str(path), LONGEST)
    meshes: dict[int, list[MeshShape]] = {}
    for geom, (vertices, faces, collides, mass) in carriers.items():
        i = geom.id
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[i])
        placed = vertices @ rotation.reshape(3, 3).T + model.geom_pos[i]
        rgba = model.geom_rgba[i].astype(float)
        if model.geom_matid[i] >= 0:
            rgba = model.mat_rgba[model.geom_matid[i]].astype(float)
        shape = MeshShape(placed, faces, collides, rgba, mass)
        meshes.setdefault(int(model.geom_bodyid[i]), []).append(shape)

    def ids(names: set[str]) -> frozenset[int]:
        return frozenset(b for b in range(1, model.nbody) if model.body(b).name in names)

    unweighed = ids(massless) - _weigh_meshes(model, meshes, ids(massless), total_mass)
    return ForeignModel(model, meshes, ids(stripped), unweighed, palm, findings)


def _weigh_meshes(
    model: mujoco.MjModel, meshes: Mapping[int, list[MeshShape]], massless: Set[int], total: float
) -> set[int]:
    """Give bodies without a mass that of their meshes, with the inertia of a box, and scale to a total mass.

    Args:
        model: model to modify.
        massless: ids of bodies without a mass.
        total: mass of the whole model [kg]; 0 if unknown.

    Returns:
        Ids of the bodies that got a mass.
    """
    weighed = set()
    for body in massless:
        shapes = meshes.get(body, [])
        # With a total mass, meshes without a mass have MuJoCo's default density.
        if not shapes or not (total > 0 or any(np.isfinite(shape.mass) for shape in shapes)):
            continue
        volumes = [abs(trimesh.Trimesh(s.vertices, s.faces, process=False).volume) for s in shapes]
        masses = [
            s.mass if np.isfinite(s.mass) else DENSITY * v for s, v in zip(shapes, volumes, strict=True)
        ]
        if sum(masses) < 1e-6:
            continue
        points = np.concatenate([s.vertices for s, mass in zip(shapes, masses, strict=True) if mass > 0])
        squares = np.ptp(points, axis=0) ** 2
        model.body_mass[body] = sum(masses)
        model.body_ipos[body] = 0.5 * (points.min(axis=0) + points.max(axis=0))
        model.body_iquat[body] = [1.0, 0.0, 0.0, 0.0]
        model.body_inertia[body] = np.maximum(sum(masses) / 12 * (squares.sum() - squares), 1e-9)
        weighed.add(body)
    if total > 0 and model.body_mass.sum() > 0:
        scale = total / model.body_mass.sum()
        model.body_mass[:] *= scale
        model.body_inertia[:] *= scale
    return weighed


def _spec(path: Path, root: ElementTree.Element, findings: list[Finding]) -> mujoco.MjSpec:
    """Parse a model without attributes that this version of MuJoCo does not know (MuJoCo renames some)."""
    dropped: list[str] = []
    while True:
        try:
            spec = parse_model(ElementTree.tostring(root, encoding="unicode"), str(path))
            break
        except (ValueError, mujoco.FatalError) as problem:
            text = one_line(problem)
            found = re.search(r"unrecognized attribute: '(\w+)' Element '(\w+)'", text)
            if found is None or len(dropped) > 20:
                raise FungraspError(f"MuJoCo cannot read {path}: {text}") from problem
            attribute, element = found.groups()
            for holder in root.iter(element):
                holder.attrib.pop(attribute, None)
            dropped.append(f"{element} {attribute}")
    if dropped:
        findings.append(note(f"MuJoCo no longer knows the attribute {listed(dropped)}: left out"))
    return spec


def _palm_and_fingers(spec: mujoco.MjSpec, palm: str | None) -> set[str]:
    """Return the names of the palm, the bodies below it and those fixed to it. Only their meshes are read.

    Raises:
        FungraspError: the palm is unknown or cannot be determined.
    """
    bare = spec.copy()
    for things in (
        bare.geoms,
        bare.meshes,
        bare.equalities,
        bare.tendons,
        bare.actuators,
        bare.sensors,
        bare.keys,
    ):
        for obj in list(things):
            bare.delete(obj)
    bare.compiler.fusestatic, bare.compiler.boundmass, bare.compiler.boundinertia = False, 1e-9, 1e-12
    bare.compiler.settotalmass = -1.0
    repair_joints(bare, [])
    for body in bare.bodies[1:]:
        body.explicitinertial = False
    try:
        model = bare.compile()
    except (ValueError, mujoco.FatalError):
        return {body.name for body in spec.bodies}
    hand = find_palm(model, palm)
    near = {
        hand,
        *subtree(model, hand),
        *np.flatnonzero(model.body_weldid == model.body_weldid[hand]).tolist(),
    }
    return {model.body(body).name for body in near}


def _take_meshes(
    spec: mujoco.MjSpec, folder: Path, urdf: bool, findings: list[Finding]
) -> tuple[Carriers, set[str]]:
    """Replace mesh geoms by small massless spheres, which keep their poses.

    Returns:
        Vertices [m], faces, whether it collides, and mass [kg] by geom; names of bodies with a missing or
        unreadable collision mesh.
    """
    loaded: dict[str, trimesh.Trimesh | None] = {}
    missing: list[str] = []
    unreadable: dict[str, str] = {}
    carriers = {}
    stripped: set[str] = set()
    meshdir = "" if urdf else spec.compiler.meshdir
    by_name = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes}
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD or geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            spec.delete(geom)
            continue
        mesh = by_name.get(geom.meshname)
        if mesh is None:
            continue
        collides = bool(geom.contype or geom.conaffinity)
        if geom.meshname not in loaded:
            loaded[geom.meshname] = _load(mesh, folder, meshdir, missing, unreadable)
        shape = loaded[geom.meshname]
        if shape is None:
            if collides:
                stripped.add(geom.parent.name)
            spec.delete(geom)
            continue
        mass = geom.mass
        if not np.isfinite(mass) and geom.density != DENSITY and np.isfinite(geom.density):
            mass = geom.density * abs(shape.volume)
        carriers[geom] = np.asarray(shape.vertices, float), np.asarray(shape.faces), collides, float(mass)
        geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, "", [1e-3, 0, 0]
        geom.mass, geom.contype, geom.conaffinity = 0.0, 0, 0
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    collada = [
        name
        for name, shape in loaded.items()
        if shape is not None and by_name[name].file.lower().endswith(".dae")
    ]
    if collada:
        findings.append(
            note(f"the mesh {listed(collada)} is read with the unit and the up axis that its .dae names")
        )
    carriers = _in_meters(carriers, findings)
    if missing:
        findings.append(
            warning(
                f"no file is found for the mesh {listed(missing)}, looked for from {folder / meshdir} up; "
                "its shape is left out"
            )
        )
    for reason in dict.fromkeys(unreadable.values()):
        files = [file for file, other in unreadable.items() if other == reason]
        words = f"the mesh {listed(files)} can't be read, its shape is left out: {reason}"
        findings.append(warning(words))
    return carriers, stripped


def _let_pictures_collide(
    spec: mujoco.MjSpec, carriers: Carriers, wanted: Set[str], findings: list[Finding]
) -> None:
    """Let visual primitives collide if the hand has no collision shape."""
    simple = [geom for geom in spec.geoms if geom not in carriers and geom.parent.name in wanted]
    if not simple or any(collides for *_, collides, _ in carriers.values()):
        return
    if not any(geom.contype or geom.conaffinity for geom in simple):
        for geom in simple:
            geom.contype = geom.conaffinity = 1
        findings.append(note("no shape of the hand collides by itself: its visual shapes are taken"))


def _in_meters(carriers: Carriers, findings: list[Finding]) -> Carriers:
    """Convert meshes that must be in millimeters to meters: all if most are too large, else single ones."""
    sizes = {geom: float(np.ptp(vertices, axis=0).max()) for geom, (vertices, *_) in carriers.items()}
    most = bool(sizes) and np.median(list(sizes.values())) > LARGEST_LINK
    wrong = {geom for geom, size in sizes.items() if most or size > LARGEST_ALONE}
    if not wrong:
        return carriers
    words = f"up to {max(sizes.values()):.3g} m large: taken to be in millimeters, without a scale"
    bodies = list(dict.fromkeys(geom.parent.name for geom in carriers if geom in wrong))
    findings.append(
        warning(f"the meshes are {words}" if most else f"the mesh of {listed(bodies)} is {words}")
    )
    return {
        geom: (0.001 * v, f, c, m * 1e-9 if m > 1e6 else m) if geom in wrong else (v, f, c, m)
        for geom, (v, f, c, m) in carriers.items()
    }


def _load(
    mesh: mujoco.MjsMesh, folder: Path, meshdir: str, missing: list[str], unreadable: dict[str, str]
) -> trimesh.Trimesh | None:
    """Return a mesh in the frame and scale of its asset; None if it is added to the missing meshes or, with
    the reason, to the unreadable ones."""
    if not mesh.file:
        vertices = np.asarray(mesh.uservert).reshape(-1, 3)
        faces = np.asarray(mesh.userface).reshape(-1, 3)
        shape = trimesh.Trimesh(vertices, faces, process=False)
        if not len(faces) and len(vertices) > 3:
            shape = trimesh.convex.convex_hull(vertices)
    else:
        path = find_mesh(mesh.file, folder, meshdir)
        if path is None:
            missing.append(mesh.file)
            return None
        try:
            shape = trimesh.Trimesh(*read_mesh(path), process=False)
        except FungraspError as problem:
            unreadable[mesh.file] = _reason(path, problem)
            return None
    if len(shape.vertices) < 4 or not np.isfinite(shape.vertices).all():
        unreadable[mesh.file or mesh.name] = "it has no surface"
        return None
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(mesh.refquat))
    placed = (
        np.asarray(shape.vertices) * np.asarray(mesh.scale) - np.asarray(mesh.refpos)
    ) @ rotation.reshape(3, 3)
    faces = np.asarray(shape.faces)
    if np.prod(mesh.scale) < 0:
        faces = faces[:, ::-1]
    return trimesh.Trimesh(placed, faces, process=False)


def find_mesh(name: str, folder: Path, meshdir: str = "") -> Path | None:
    """Find the file of a mesh, also by URIs (package://, model://, file://) and by parts of its path in the
    model's folder and those above. Return None if there is none.

    Args:
        folder: folder of the model.
        meshdir: mesh folder named in the model, relative to these folders.
    """
    relative = unquote(re.sub(r"^(package|model|file)://", "", name)).replace("\\", "/")
    parts = [part for part in relative.split("/") if part]
    tries = [Path(relative)] if relative.startswith("/") else []
    tries += [folder / name]
    above = [folder, *folder.resolve().parents[:MAX_PARENTS]]
    folders = [*(place / meshdir for place in above if meshdir), *above]
    # Leading parts may be the name of a package, or folders of another machine.
    for skip in range(len(parts)):
        tries += [place.joinpath(*parts[skip:]) for place in folders]
    tries += [place / "meshes" / parts[-1] for place in folders[:2]] if parts else []
    return next((path for path in tries if path.is_file()), None)


def _reason(path: Path, problem: FungraspError) -> str:
    """Return the error message without the path."""
    return str(problem).split(str(path))[-1].strip(" :")
