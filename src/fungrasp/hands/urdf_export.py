"""A hand as a URDF, which programs without MuJoCo read."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as xml

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path
from fungrasp.hands.hand import Hand

WRIST_JOINTS = ("wrist_x", "wrist_y", "wrist_z", "wrist_rx", "wrist_ry", "wrist_rz")
"""Of a hand that moves freely: along the world's axes, then about x, the turned y and the turned z."""

FAR = 1e3
"""Limit of joints that have none [m, rad]: URDF asks for one."""

_WORLD = "world"
_SHAPES = mujoco.mjtGeom
_KINDS = {int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic", int(mujoco.mjtJoint.mjJNT_HINGE): "revolute"}


def write_hand_urdf(hand: Hand, folder: str | Path, *, free: bool = False) -> Path:
    """Write ``<hand>.urdf``, and its meshes in ``meshes``.

    Links are the bodies of the hand's model, joints its joints; coupled ones mimic. A body with several
    joints gets links of almost no mass between them.

    Args:
        hand: any hand.
        folder: is made.
        free: whether the palm moves in the world by six joints, ``WRIST_JOINTS``; else it is fixed there.

    Returns:
        the path of the URDF.

    Raises:
        FungraspError: a file can't be written.
    """
    folder = Path(folder)
    robot = xml.Element("robot", name=hand.name)
    xml.SubElement(robot, "link", name=_WORLD)
    tree = _Tree(robot, hand.model, folder)
    # The palm is at the world's origin, and the first body after it.
    tree.add(1, _free_wrist(robot) if free else _WORLD)
    for body in range(2, hand.model.nbody):
        tree.add(body, tree.links[int(hand.model.body_parentid[body])])
    _mimic(robot, hand.model)
    xml.indent(robot)
    path = folder / f"{hand.name}.urdf"
    with atomic_path(path) as temporary:
        xml.ElementTree(robot).write(temporary, encoding="unicode", xml_declaration=True)
    return path


class _Tree:
    """Links and joints as they are added, parents first."""

    def __init__(self, robot: xml.Element, model: mujoco.MjModel, folder: Path):
        self._robot, self._model, self._folder = robot, model, folder
        self.links: dict[int, str] = {0: _WORLD}
        # A link's frame is at its joint, which MuJoCo may put elsewhere in the body.
        self._shift: dict[int, np.ndarray] = {0: np.zeros(3)}

    def add(self, body: int, parent: str) -> None:
        """A body with its joints."""
        m = self._model
        name = m.body(body).name or f"body {body}"
        joints = range(int(m.body_jntadr[body]), int(m.body_jntadr[body]) + int(m.body_jntnum[body]))
        places = [m.jnt_pos[j] for j in joints]
        if any(np.abs(place - places[0]).max() > 1e-9 for place in places):
            raise FungraspError(f"a URDF can't hold body '{name}': its joints are at several places")
        shift = places[0].copy() if places else np.zeros(3)
        turn, place = _rotation(m.body_quat[body]), m.body_pos[body]
        origin = place + turn @ shift - self._shift[int(m.body_parentid[body])]
        self.links[body], self._shift[body] = name, shift
        angles = _angles(m.body_quat[body])
        if not joints:
            _joint(self._robot, f"{name}_fixed", "fixed", parent, name, origin, angles)
        for count, j in enumerate(joints):
            last = count == len(joints) - 1
            child = name if last else f"{name}_{m.joint(j).name}"
            kind = _KINDS.get(int(m.jnt_type[j]))
            if kind is None:
                raise FungraspError(f"a URDF can't hold the joint '{m.joint(j).name}' of several axes")
            limits = m.jnt_range[j] if m.jnt_limited[j] else np.array([-FAR, FAR])
            _joint(self._robot, m.joint(j).name, kind, parent, child, origin, angles, m.jnt_axis[j], limits)
            if not last:
                _light_link(self._robot, child)
            parent, origin, angles = child, np.zeros(3), np.zeros(3)
        self._link(body, name, shift)

    def _link(self, body: int, name: str, shift: np.ndarray) -> None:
        m = self._model
        link = xml.SubElement(self._robot, "link", name=name)
        inertial = xml.SubElement(link, "inertial")
        _origin(inertial, m.body_ipos[body] - shift, _angles(m.body_iquat[body]))
        xml.SubElement(inertial, "mass", value=f"{float(m.body_mass[body]):.9g}")
        ixx, iyy, izz = (f"{float(v):.9g}" for v in m.body_inertia[body])
        xml.SubElement(inertial, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)
        geoms = np.flatnonzero(m.geom_bodyid == body).tolist()
        collides = [bool(m.geom_contype[g] | m.geom_conaffinity[g]) for g in geoms]
        for geom, hit in zip(geoms, collides, strict=True):
            # Where nothing is for the eye alone, what collides is seen.
            kinds = ["collision"] * hit + ["visual"] * (not hit or all(collides))
            for kind in kinds:
                for offset, shape in self._shapes(geom):
                    part = xml.SubElement(link, kind)
                    turn = _rotation(m.geom_quat[geom])
                    _origin(part, m.geom_pos[geom] + turn @ offset - shift, _angles(m.geom_quat[geom]))
                    xml.SubElement(part, "geometry").append(shape)

    def _shapes(self, geom: int) -> list[tuple[np.ndarray, xml.Element]]:
        """A geom's shapes and where they are in it."""
        m = self._model
        size, kind = [float(v) for v in m.geom_size[geom]], int(m.geom_type[geom])
        here = np.zeros(3)
        if kind == _SHAPES.mjGEOM_BOX:
            return [(here, xml.Element("box", size=_text(2 * np.array(size))))]
        if kind == _SHAPES.mjGEOM_SPHERE:
            return [(here, xml.Element("sphere", radius=f"{size[0]:.9g}"))]
        if kind in (_SHAPES.mjGEOM_CYLINDER, _SHAPES.mjGEOM_CAPSULE):
            tube = xml.Element("cylinder", radius=f"{size[0]:.9g}", length=f"{2 * size[1]:.9g}")
            ends = [np.array([0.0, 0.0, side * size[1]]) for side in (-1, 1)]
            balls = [(end, xml.Element("sphere", radius=f"{size[0]:.9g}")) for end in ends]
            return [(here, tube), *(balls if kind == _SHAPES.mjGEOM_CAPSULE else [])]
        return [(here, xml.Element("mesh", filename=self._mesh(geom)))]

    def _mesh(self, geom: int) -> str:
        """The file of a mesh or an ellipsoid, relative to the URDF."""
        import trimesh

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
        name = f"meshes/{geom}.obj"
        with atomic_path(self._folder / name) as temporary:
            solid = trimesh.Trimesh(vertices, faces, process=False)
            solid.export(str(temporary), "obj", include_normals=False, digits=9)
        return name


def _free_wrist(robot: xml.Element) -> str:
    """Six joints in the world; the link at their end."""
    parent = _WORLD
    for number, name in enumerate(WRIST_JOINTS):
        child = f"{name}_link"
        axis, limits = np.eye(3)[number % 3], np.array([-FAR, FAR])
        kind = "prismatic" if number < 3 else "revolute"
        _joint(robot, name, kind, parent, child, np.zeros(3), np.zeros(3), axis, limits)
        _light_link(robot, child)
        parent = child
    return parent


def _light_link(robot: xml.Element, name: str) -> None:
    """A link between two joints: simulators refuse one without mass."""
    inertial = xml.SubElement(xml.SubElement(robot, "link", name=name), "inertial")
    xml.SubElement(inertial, "mass", value="1e-6")
    xml.SubElement(inertial, "inertia", ixx="1e-9", ixy="0", ixz="0", iyy="1e-9", iyz="0", izz="1e-9")


def _joint(
    robot: xml.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: np.ndarray,
    angles: np.ndarray,
    axis: np.ndarray | None = None,
    limits: np.ndarray | None = None,
) -> None:
    joint = xml.SubElement(robot, "joint", name=name, type=kind)
    _origin(joint, place, angles)
    xml.SubElement(joint, "parent", link=parent)
    xml.SubElement(joint, "child", link=child)
    if axis is not None and limits is not None:
        xml.SubElement(joint, "axis", xyz=_text(axis))
        low, high = (f"{float(v):.9g}" for v in limits)
        xml.SubElement(joint, "limit", lower=low, upper=high, effort="10", velocity="10")


def _mimic(robot: xml.Element, m: mujoco.MjModel) -> None:
    """What a joint equality couples; a URDF holds linear couplings."""
    named = {joint.get("name"): joint for joint in robot.findall("joint")}
    for e in range(m.neq):
        if m.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and m.eq_obj2id[e] >= 0:
            driven, driver = m.joint(int(m.eq_obj1id[e])).name, m.joint(int(m.eq_obj2id[e])).name
            offset, slope = (f"{float(v):.9g}" for v in m.eq_data[e, :2])
            xml.SubElement(named[driven], "mimic", joint=driver, multiplier=slope, offset=offset)


def _origin(element: xml.Element, place: np.ndarray, angles: np.ndarray) -> None:
    xml.SubElement(element, "origin", xyz=_text(place), rpy=_text(angles))


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _angles(quaternion: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw of URDF: about the fixed x, y and z [rad], shape [3]."""
    r = _rotation(quaternion)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:
        # Straight up or down: roll alone turns.
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _text(values: np.ndarray) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)
