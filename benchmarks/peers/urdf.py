"""A hand's kinematics as URDF, which other packages read: bodies, joints, couplings and key points, no
shapes."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.hands import Hand


def kinematic_urdf(hand: Hand) -> str:
    """URDF text of a hand, the palm as its root.

    Links are named as the model's bodies and sites, joints as its joints; a body that has several joints,
    or one away from its origin, gets links between, "BODY/1" and so on.
    """
    model = hand.model
    robot = ElementTree.Element("robot", name=hand.name)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    _link(robot, hand.palm)
    palm = model.body(hand.palm).id
    order = [b for b in range(1, model.nbody) if b != palm]
    for body in order:
        name, parent = model.body(body).name, int(model.body_parentid[body])
        place, turn = model.body_pos[body], model.body_quat[body]
        if parent == 0:
            # What stands still beside the palm hangs on it.
            inverse = data.xmat[palm].reshape(3, 3).T
            place = inverse @ (data.xpos[body] - data.xpos[palm])
            turn = Rotation.from_matrix(inverse @ data.xmat[body].reshape(3, 3)).as_quat(scalar_first=True)
        above = hand.palm if parent == 0 else model.body(parent).name
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        if not count:
            _link(robot, name)
            _joint(robot, f"{name}/fixed", "fixed", above, name, place, turn)
        for k in range(count):
            joint = first + k
            here = f"{name}/{k}"
            _link(robot, here)
            # The joint's frame has the body's axes, its origin at the anchor.
            offset = model.jnt_pos[joint] if k == 0 else model.jnt_pos[joint] - model.jnt_pos[joint - 1]
            origin = place + Rotation.from_quat(turn, scalar_first=True).apply(offset) if k == 0 else offset
            made = _joint(
                robot,
                model.joint(joint).name,
                "revolute",
                above,
                here,
                origin,
                turn if k == 0 else np.array([1.0, 0, 0, 0]),
            )
            _moves(made, hand, joint)
            above = here
        if count:
            _link(robot, name)
            back = -model.jnt_pos[first + count - 1]
            _joint(robot, f"{name}/fixed", "fixed", above, name, back, np.array([1.0, 0, 0, 0]))
    for site in range(model.nsite):
        name, body = model.site(site).name, model.body(int(model.site_bodyid[site])).name
        if name in hand.keypoint_names:
            _link(robot, name)
            identity = np.array([1.0, 0, 0, 0])
            _joint(robot, f"{name}/fixed", "fixed", body, name, model.site_pos[site], identity)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")


def _link(robot: ElementTree.Element, name: str) -> None:
    inertial = ElementTree.SubElement(ElementTree.SubElement(robot, "link", name=name), "inertial")
    ElementTree.SubElement(inertial, "mass", value="0.01")
    ElementTree.SubElement(inertial, "inertia", ixx="1e-6", iyy="1e-6", izz="1e-6", ixy="0", ixz="0", iyz="0")


def _joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: np.ndarray,
    turn: np.ndarray,
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    # URDF: rotations about the fixed axes x, y, z in turn.
    angles = Rotation.from_quat(turn, scalar_first=True).as_euler("xyz")
    ElementTree.SubElement(joint, "origin", xyz=_numbers(place), rpy=_numbers(angles))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    return joint


def _moves(joint: ElementTree.Element, hand: Hand, number: int) -> None:
    """Axis, limits and coupling of one of the hand's joints."""
    model, (matrix, offset) = hand.model, hand.coupling
    ElementTree.SubElement(joint, "axis", xyz=_numbers(model.jnt_axis[number]))
    low, high = hand.joint_limits[number]
    ElementTree.SubElement(
        joint, "limit", lower=repr(float(low)), upper=repr(float(high)), effort="10", velocity="10"
    )
    independent = list(hand.actuators)
    name = model.joint(number).name
    if name not in independent and np.any(matrix[number]):
        source = int(np.abs(matrix[number]).argmax())
        slope = float(matrix[number, source])
        ElementTree.SubElement(
            joint,
            "mimic",
            joint=independent[source],
            multiplier=repr(slope),
            offset=repr(float(offset[number])),
        )


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in values)
