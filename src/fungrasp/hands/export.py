"""Export of models to other programs, as self-contained MJCF or URDF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as xml

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.geometry.poses import compose, invert
from fungrasp.hands.kinematic_tree import drives


def self_contained_xml(spec: mujoco.MjSpec) -> str:
    """Return the self-contained MJCF of a model. ``spec`` is not modified.

    Meshes are written as vertices and faces; texture files are omitted.

    Raises:
        FungraspError: the model does not compile, or cannot be written as one file.
    """
    spec = spec.copy()
    try:
        model = spec.compile()
        _drop_pictures(spec)
        _inline_meshes(spec, model)
        text = spec.to_xml()
        mujoco.MjModel.from_xml_string(text)
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise FungraspError(
            f"the model '{spec.modelname}' cannot be written as one MJCF file: {reason}"
        ) from error
    return text


def _drop_pictures(spec: mujoco.MjSpec) -> None:
    pictures = {texture.name for texture in spec.textures if texture.file or any(texture.cubefiles)}
    for material in spec.materials:
        material.textures = ["" if name in pictures else name for name in material.textures]
    for texture in list(spec.textures):
        if texture.name in pictures:
            spec.delete(texture)


def _inline_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Replace mesh files by their vertices, in the frame and scale of the geoms."""
    for mesh in spec.meshes:
        if not mesh.file:
            continue
        i = mesh.id
        vertices = model.mesh_vert[model.mesh_vertadr[i] :][: model.mesh_vertnum[i]].astype(float)
        faces = model.mesh_face[model.mesh_faceadr[i] :][: model.mesh_facenum[i]]
        rotation = np.zeros(9)
        # The compiler moves a mesh to its inertial frame; this moves it back.
        mujoco.mju_quat2Mat(rotation, model.mesh_quat[i])
        vertices = vertices @ rotation.reshape(3, 3).T + model.mesh_pos[i]
        # MuJoCo names an unnamed mesh after its file, and geoms refer to that name.
        mesh.name = model.mesh(i).name
        mesh.file = ""
        mesh.uservert = vertices.ravel()
        mesh.userface = faces.ravel()
        mesh.scale, mesh.refpos, mesh.refquat = [1, 1, 1], [0, 0, 0], [1, 0, 0, 0]


FAR = 1e3
"""Limit and effort of joints without one [m, rad; N, N m]: URDF requires both."""

LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""Smallest mass [kg] and principal inertia [kg m^2] of links: physics engines reject zero."""

SPEED = 10.0
"""Speed limit of joints [rad/s, m/s]: URDF requires one, and MuJoCo models have none."""

_WORLD = "world"
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
_SHAPES = mujoco.mjtGeom
_KINDS = {int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic", int(mujoco.mjtJoint.mjJNT_HINGE): "revolute"}


def model_urdf(
    name: str,
    model: mujoco.MjModel,
    meshes: Path | None,
    *,
    frames: Mapping[str, str] | None = None,
) -> xml.Element:
    """Return the URDF of a model. Bodies become links and coupled joints mimic their drivers.

    A body with several joints, or with a joint away from its origin, gets nearly massless links before it.
    The root is ``world``.

    Args:
        model: model with hinges and slides only.
        meshes: folder to write meshes to; the URDF names them by URI. If None, links have no geometry.
        frames: names of nearly massless links to add, by the site at their origin.

    Raises:
        FungraspError: URDF does not support a joint or geom, or a mesh cannot be written.
    """
    robot = xml.Element("robot", name=name)
    xml.SubElement(robot, "link", name=_WORLD)
    tree = _Tree(robot, model, meshes)
    for body in range(1, model.nbody):
        above = int(model.body_parentid[body])
        tree.add(body, tree.links[above] if above else _WORLD)
    for site, link in (frames or {}).items():
        number = model.site(site).id
        pose = np.concatenate([model.site_pos[number], model.site_quat[number]])
        _joint(robot, f"{link}_frame", "fixed", tree.links[int(model.site_bodyid[number])], link, pose)
        _light_link(robot, link)
    _mimic(robot, model)
    xml.indent(robot)
    return robot


class _Tree:
    """Adds links and joints, parents first."""

    def __init__(self, robot: xml.Element, model: mujoco.MjModel, meshes: Path | None):
        self._robot, self._model, self._meshes = robot, model, meshes
        self.links: dict[int, str] = {}

    def add(self, body: int, parent: str) -> None:
        """Add a body: a link with the joint's frame after each joint; the last one has the body's frame."""
        m = self._model
        name = self.links[body] = m.body(body).name or f"body {body}"
        place = np.concatenate([m.body_pos[body], m.body_quat[body]])
        first, count = int(m.body_jntadr[body]), int(m.body_jntnum[body])
        for number in range(first, first + count):
            # In URDF, a joint rotates about the origin of its child's frame.
            anchor = np.concatenate([m.jnt_pos[number], _IDENTITY[3:]])
            centered = np.allclose(m.jnt_pos[number], 0)
            last = centered and number == first + count - 1
            child = name if last else f"{name}_{m.joint(number).name}"
            self._move(number, parent, child, compose(place, anchor))
            if not last:
                _light_link(self._robot, child)
            parent, place = child, _IDENTITY if centered else invert(anchor)
        if parent != name:
            _joint(self._robot, f"{name}_fixed", "fixed", parent, name, place)
        self._link(body, name)

    def _move(self, number: int, parent: str, child: str, pose: np.ndarray) -> None:
        m = self._model
        name, kind = m.joint(number).name, _KINDS.get(int(m.jnt_type[number]))
        if kind is None:
            raise FungraspError(f"a URDF can't hold the joint '{name}' of several axes")
        limits = m.jnt_range[number] if m.jnt_limited[number] else np.array([-FAR, FAR])
        moving = (m.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (m.actuator_trnid[:, 0] == number)
        torques = [m.jnt_actfrcrange[number], *m.actuator_forcerange[moving]]
        effort = float(np.abs(torques).max()) or FAR
        joint = _joint(self._robot, name, kind, parent, child, pose)
        xml.SubElement(joint, "axis", xyz=_text(m.jnt_axis[number]))
        low, high = (_text([v]) for v in limits)
        xml.SubElement(joint, "limit", lower=low, upper=high, effort=_text([effort]), velocity=_text([SPEED]))

    def _link(self, body: int, name: str) -> None:
        m = self._model
        link = xml.SubElement(self._robot, "link", name=name)
        _inertial(
            link,
            np.concatenate([m.body_ipos[body], m.body_iquat[body]]),
            float(m.body_mass[body]),
            m.body_inertia[body],
        )
        if self._meshes is None:
            return
        geoms = np.flatnonzero(m.geom_bodyid == body).tolist()
        collides = [bool(m.geom_contype[g] | m.geom_conaffinity[g]) for g in geoms]
        for geom, hit in zip(geoms, collides, strict=True):
            # If a body has no visual geoms, its collision geoms are shown.
            kinds = ["collision"] * hit + ["visual"] * (not hit or all(collides))
            for kind in kinds:
                for place, shape in self._shapes(geom):
                    part = xml.SubElement(link, kind)
                    _origin(part, place)
                    xml.SubElement(part, "geometry").append(shape)

    def _shapes(self, geom: int) -> list[tuple[np.ndarray, xml.Element]]:
        """Return the URDF geometries of a geom and their poses, body frame."""
        m = self._model
        size, kind = [float(v) for v in m.geom_size[geom]], int(m.geom_type[geom])
        here = np.concatenate([m.geom_pos[geom], m.geom_quat[geom]])
        if kind == _SHAPES.mjGEOM_BOX:
            return [(here, xml.Element("box", size=_text(2 * np.array(size))))]
        if kind == _SHAPES.mjGEOM_SPHERE:
            return [(here, xml.Element("sphere", radius=_text(size[:1])))]
        if kind in (_SHAPES.mjGEOM_CYLINDER, _SHAPES.mjGEOM_CAPSULE):
            tube = xml.Element("cylinder", radius=_text(size[:1]), length=_text([2 * size[1]]))
            ends = [compose(here, np.array([0, 0, side * size[1], 1, 0, 0, 0])) for side in (-1, 1)]
            balls = [(end, xml.Element("sphere", radius=_text(size[:1]))) for end in ends]
            return [(here, tube), *(balls if kind == _SHAPES.mjGEOM_CAPSULE else [])]
        return [(here, xml.Element("mesh", filename=self._mesh(geom)))]

    def _mesh(self, geom: int) -> str:
        """Write the mesh of a mesh geom or ellipsoid; return its URI."""
        import trimesh

        assert self._meshes is not None
        m, mesh = self._model, int(self._model.geom_dataid[geom])
        if mesh >= 0:
            start, first = int(m.mesh_vertadr[mesh]), int(m.mesh_faceadr[mesh])
            vertices = m.mesh_vert[start : start + int(m.mesh_vertnum[mesh])]
            faces = m.mesh_face[first : first + int(m.mesh_facenum[mesh])]
        elif int(m.geom_type[geom]) == _SHAPES.mjGEOM_ELLIPSOID:
            ball = trimesh.creation.icosphere(3)
            vertices, faces = ball.vertices * m.geom_size[geom], ball.faces
        else:
            raise FungraspError(f"a URDF can't hold a geom of MuJoCo's type {int(m.geom_type[geom])}")
        path = self._meshes / f"{geom}.obj"
        with atomic_path(path) as temporary:
            solid = trimesh.Trimesh(vertices, faces, process=False)
            solid.export(str(temporary), "obj", include_normals=False, digits=9)
        return path.resolve().as_uri()


def _light_link(robot: xml.Element, name: str) -> None:
    """Add a link with the smallest mass."""
    _inertial(xml.SubElement(robot, "link", name=name), _IDENTITY, 0.0, np.zeros(3))


def _inertial(link: xml.Element, pose: np.ndarray, mass: float, inertia: np.ndarray) -> None:
    inertial = xml.SubElement(link, "inertial")
    _origin(inertial, pose)
    xml.SubElement(inertial, "mass", value=_text([max(mass, LEAST_MASS)]))
    xx, yy, zz = (_text([max(float(v), LEAST_INERTIA)]) for v in inertia)
    xml.SubElement(inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)


def _joint(
    robot: xml.Element, name: str, kind: str, parent: str, child: str, pose: np.ndarray
) -> xml.Element:
    joint = xml.SubElement(robot, "joint", name=name, type=kind)
    _origin(joint, pose)
    xml.SubElement(joint, "parent", link=parent)
    xml.SubElement(joint, "child", link=child)
    return joint


def _mimic(robot: xml.Element, m: mujoco.MjModel) -> None:
    """Add the linear part of joint equalities, the only couplings of URDF."""
    named = {joint.get("name"): joint for joint in robot.findall("joint")}
    for joint, drive in drives(m).items():
        offset, slope = _text([drive.constant]), _text([drive.slope])
        driver = m.joint(drive.driver).name
        xml.SubElement(named[m.joint(joint).name], "mimic", joint=driver, multiplier=slope, offset=offset)


def _origin(element: xml.Element, pose: np.ndarray) -> None:
    xml.SubElement(element, "origin", xyz=_text(pose[:3]), rpy=_text(_angles(pose[3:])))


def _angles(quaternion: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw as in URDF, about the fixed x, y and z axes [rad], shape [3]."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    r = matrix.reshape(3, 3)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:
        # Gimbal lock: yaw is set to zero.
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _text(values: np.ndarray | list[float]) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)
