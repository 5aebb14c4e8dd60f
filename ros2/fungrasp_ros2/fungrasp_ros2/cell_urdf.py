"""A URDF of a cell's robot: arm, mount and hand as the cell's file says them, so that RViz, tf and MoveIt see
the hand where fungrasp does. Needs no ROS.

    ros2 run fungrasp_ros2 cell_urdf lab.toml lab.urdf

Links and joints have the names of our models; ``world`` is the cell's world, ``tool0`` the flange,
``fungrasp_palm`` the frame of the palm. Shapes are those of collisions; meshes are written beside the file.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, invert
from fungrasp.hands import Hand, load_hand
from fungrasp.hands.arm import FLANGE_SITE, PALM_SITE, mount
from fungrasp.robots.cell import RobotCell, load_cell

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""Of links [kg, kg m^2]: physics engines refuse links without any."""


def cell_urdf(cell: RobotCell, hand: Hand, meshes: Path) -> str:
    """URDF of the robot of a cell.

    Args:
        cell: the robot.
        hand: on its arm.
        meshes: folder, made where needed, that meshes are written to.

    Raises:
        FungraspError: a joint that is no hinge and no slide.
    """
    spec = mount(hand, cell.arm.model, cell.mount)
    base = spec.worldbody.first_body()
    base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
    model = spec.compile()
    robot = ET.Element("robot", name=cell.name)
    ET.SubElement(robot, "link", name="world")
    for body in range(1, model.nbody):
        _add_body(robot, model, body, meshes)
    for site, name in ((FLANGE_SITE, "tool0"), (PALM_SITE, "fungrasp_palm")):
        number = model.site(site).id
        pose = np.concatenate([model.site_pos[number], model.site_quat[number]])
        _add_joint(robot, f"{name}_frame", "fixed", _body_name(model, model.site_bodyid[number]), name, pose)
        ET.SubElement(robot, "link", name=name)
    _add_couplings(robot, model)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _add_body(robot: ET.Element, model: mujoco.MjModel, body: int, meshes: Path) -> None:
    """A body: a link after each of its joints, whose frame is the joint's; the last one carries the body."""
    name, parent = _body_name(model, body), _body_name(model, model.body_parentid[body])
    place = np.concatenate([model.body_pos[body], model.body_quat[body]])
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    for number in range(first, first + count):
        # A URDF's joint turns about the origin of its child's frame.
        anchor = np.concatenate([model.jnt_pos[number], IDENTITY[3:]])
        last = number == first + count - 1
        centered = np.allclose(model.jnt_pos[number], 0)
        child = name if last and centered else f"{name}_of_{model.joint(number).name}"
        _add_moving(robot, model, number, parent, child, compose(place, anchor))
        if child != name:
            ET.SubElement(robot, "link", name=child)
        parent, place = child, IDENTITY if centered else invert(anchor)
        if last and not centered:
            _add_joint(robot, f"{name}_frame", "fixed", parent, name, place)
    if not count:
        _add_joint(robot, f"{name}_frame", "fixed", parent, name, place)
    link = ET.SubElement(robot, "link", name=name)
    _add_inertia(link, model, body)
    for geom in np.flatnonzero(model.geom_bodyid == body):
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            _add_shapes(link, model, int(geom), meshes)


def _add_moving(
    robot: ET.Element, model: mujoco.MjModel, number: int, parent: str, child: str, pose: np.ndarray
) -> None:
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
    name, kind = model.joint(number).name, kinds.get(int(model.jnt_type[number]))
    if kind is None:
        raise FungraspError(f"joint '{name}' is no hinge and no slide: a URDF of it can't be written")
    joint = _add_joint(robot, name, kind, parent, child, pose)
    ET.SubElement(joint, "axis", xyz=_numbers(model.jnt_axis[number]))
    lower, upper = model.jnt_range[number]
    torque = float(np.abs(model.jnt_actfrcrange[number]).max())
    for actuator in np.flatnonzero(model.actuator_trnid[:, 0] == number):
        torque = max(torque, float(np.abs(model.actuator_forcerange[actuator]).max()))
    ET.SubElement(
        joint, "limit", lower=f"{lower:.6g}", upper=f"{upper:.6g}", effort=f"{torque:.6g}", velocity="3.14"
    )


def _add_joint(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, pose: np.ndarray
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    _add_origin(joint, pose)
    return joint


def _add_inertia(link: ET.Element, model: mujoco.MjModel, body: int) -> None:
    inertial = ET.SubElement(link, "inertial")
    _add_origin(inertial, np.concatenate([model.body_ipos[body], model.body_iquat[body]]))
    ET.SubElement(inertial, "mass", value=f"{max(float(model.body_mass[body]), LEAST_MASS):.6g}")
    xx, yy, zz = (f"{max(float(v), LEAST_INERTIA):.6g}" for v in model.body_inertia[body])
    ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")


def _add_shapes(link: ET.Element, model: mujoco.MjModel, geom: int, meshes: Path) -> None:
    size, kind = model.geom_size[geom], mujoco.mjtGeom(int(model.geom_type[geom]))
    pose = np.concatenate([model.geom_pos[geom], model.geom_quat[geom]])
    ends = [compose(pose, np.array([0, 0, z, 1, 0, 0, 0])) for z in (size[1], -size[1])]
    shapes: list[tuple[np.ndarray, str, dict[str, str]]] = []
    if kind is mujoco.mjtGeom.mjGEOM_BOX:
        shapes = [(pose, "box", {"size": _numbers(2 * size)})]
    elif kind is mujoco.mjtGeom.mjGEOM_SPHERE:
        shapes = [(pose, "sphere", {"radius": f"{size[0]:.6g}"})]
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        tube = {"radius": f"{size[0]:.6g}", "length": f"{2 * size[1]:.6g}"}
        shapes = [(pose, "cylinder", tube)]
        if kind is mujoco.mjtGeom.mjGEOM_CAPSULE:
            shapes += [(end, "sphere", {"radius": f"{size[0]:.6g}"}) for end in ends]
    elif kind is mujoco.mjtGeom.mjGEOM_MESH:
        shapes = [(pose, "mesh", {"filename": _write_mesh(model, int(model.geom_dataid[geom]), meshes)})]
    for place, shape, sizes in shapes:
        for use in ("visual", "collision"):
            part = ET.SubElement(link, use)
            _add_origin(part, place)
            ET.SubElement(ET.SubElement(part, "geometry"), shape, sizes)


def _write_mesh(model: mujoco.MjModel, mesh: int, folder: Path) -> str:
    import trimesh

    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    faces, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    shape = trimesh.Trimesh(
        model.mesh_vert[first : first + count], model.mesh_face[faces : faces + number], process=False
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = (folder / f"{model.mesh(mesh).name}.stl").resolve()
    shape.export(path)
    return path.as_uri()


def _add_couplings(robot: ET.Element, model: mujoco.MjModel) -> None:
    """Joints that follow others: ``mimic``. Of a coupling only what is linear counts, as in our hands."""
    joints = {joint.get("name"): joint for joint in robot.iter("joint")}
    for number in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT):
        follower, leader = model.eq_obj1id[number], model.eq_obj2id[number]
        if leader >= 0:
            offset, slope = model.eq_data[number][:2]
            ET.SubElement(
                joints[model.joint(follower).name],
                "mimic",
                joint=model.joint(leader).name,
                multiplier=f"{slope:.6g}",
                offset=f"{offset:.6g}",
            )


def _body_name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name


def _add_origin(element: ET.Element, pose: np.ndarray) -> None:
    ET.SubElement(element, "origin", xyz=_numbers(pose[:3]), rpy=_numbers(_roll_pitch_yaw(pose[3:])))


def _roll_pitch_yaw(quaternion: np.ndarray) -> np.ndarray:
    """Angles about the fixed axes x, y, z [rad], as a URDF has them."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion / np.linalg.norm(quaternion))
    r = rotation.reshape(3, 3)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:
        # Upright: one of the other two may be anything.
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{v:.10g}" for v in values)


def main() -> None:
    """``cell_urdf CELL FILE``."""
    parser = argparse.ArgumentParser(description="Write a URDF of a cell's robot.")
    parser.add_argument("cell", help="a TOML file, or a cell that comes with fungrasp")
    parser.add_argument("file", type=Path, help="URDF to write; meshes go into a folder beside it")
    given, _ = parser.parse_known_args()
    try:
        cell = load_cell(given.cell)
        text = cell_urdf(cell, load_hand(cell.hand), given.file.with_name(f"{given.file.stem}_meshes"))
        given.file.write_text(text, encoding="utf-8")
    except (FungraspError, OSError) as error:
        sys.exit(f"cell_urdf: error: {error}")
