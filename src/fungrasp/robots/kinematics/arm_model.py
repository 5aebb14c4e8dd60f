"""Forward kinematics of an arm that carries a hand, and its clearance from the table and from itself."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.arm import FLANGE_SITE, PALM_SITE, arm_spec, mount, mounting_pose
from fungrasp.hands.kinematic_tree import subtree
from fungrasp.objects import ObjectModel
from fungrasp.objects.convex_decomposition import convex_hull
from fungrasp.robots.cell import RobotCell, Workspace

OBJECT = "object to keep clear of"
"""Name of the object's body, mesh and geom."""

OBSTACLE = "obstacle"
"""Prefix of the obstacles' geoms."""

MARGIN = 0.03
"""Largest distance that is measured [m]."""

CLEAR = 0.005
"""Distance of planned postures from the robot itself and, for arm and hand, from table and obstacles [m]."""


class ArmKinematics:
    """The arm of a cell, M joints, with the palm on its flange but without fingers."""

    def __init__(self, cell: RobotCell, hand: Hand):
        spec = arm_spec(cell.arm.model)
        base = spec.worldbody.first_body()
        base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
        flange, pose = spec.site(FLANGE_SITE), mounting_pose(hand, cell.mount)
        flange.parent.add_site(name=PALM_SITE, pos=pose[:3], quat=pose[3:])
        self.model = spec.compile()
        """Compiled model of the arm, in the world frame of the cell."""
        self._data = mujoco.MjData(self.model)
        self._site = self.model.site(PALM_SITE).id
        self.lower, self.upper = self.model.jnt_range.T

    def palm_pose(self, joints: np.ndarray) -> np.ndarray:
        """Return the palm pose, world frame, shape [7]. joints: [rad], shape [M]."""
        d = self._data
        d.qpos[:] = joints
        mujoco.mj_kinematics(self.model, d)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, d.site_xmat[self._site])
        return np.concatenate([d.site_xpos[self._site], quaternion])

    def jacobian(self, joints: np.ndarray) -> np.ndarray:
        """Return the Jacobian of the palm's position [m] and rotation [rad], world frame, shape [6, M].
        joints: [rad], shape [M]."""
        m, d = self.model, self._data
        d.qpos[:] = joints
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        result = np.zeros((6, m.nv))
        mujoco.mj_jacSite(m, d, result[:3], result[3:], self._site)
        return result

    def manipulability(self, joints: np.ndarray) -> float:
        """Return the smallest singular value of the Jacobian, with positions in units of 0.5 m; zero at a
        singularity. joints: [rad], shape [M]."""
        jacobian = self.jacobian(joints)
        jacobian[:3] /= 0.5
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


@dataclass(frozen=True)
class Clearance:
    """Distances in a posture, at most ``MARGIN``, negative for penetration [m]."""

    table: float = MARGIN
    """Distance of the arm from the table."""
    hand: float = MARGIN
    """Distance of the hand from the table."""
    itself: float = MARGIN
    """Distance of the arm from itself and from the hand."""
    obstacle: float = MARGIN
    """Distance of arm and hand from the cell's obstacles."""

    def fault(self, box: Workspace, room: float = 0.0, apart: float = 0.0) -> str:
        """Return which distance is too small, as a phrase; "" if none.

        Args:
            box: workspace with the required distances.
            room: additional distance from table and obstacles [m]; half of it for the hand at the table.
            apart: required distance from the robot itself [m].
        """
        if self.table < box.table_clearance + room:
            return "the arm would touch the table"
        if self.hand < 0.5 * room - box.hand_depth:
            return (
                "the hand would press into the table, or come too near to it (workspace.hand_depth = "
                f"{box.hand_depth:g})"
            )
        if self.obstacle < box.table_clearance + room:
            return "the arm or the hand would touch an obstacle"
        return "the arm or the hand would touch the arm" if self.itself < apart else ""


def outside(palm: np.ndarray, box: Workspace) -> str:
    """Return where palm poses leave the workspace, as a phrase; "" if nowhere. palm: world frame, shape [...,
    7]."""
    places = palm[..., :3].reshape(-1, 3)
    for side, corner, beyond in (
        ("lower", box.lower, box.lower - places),
        ("upper", box.upper, places - np.array(box.upper)),
    ):
        row, axis = np.unravel_index(np.argmax(beyond), beyond.shape)
        if beyond[row, axis] > 0:
            place, limit = places[row, axis], corner[axis]
            return (
                f"the palm would leave the workspace box ({'xyz'[axis]} = {place:.2f} m, and workspace.{side}"
                f" has {limit:g})"
            )
    return ""


class ClearanceModel:
    """Measures the clearance of the whole robot."""

    def __init__(self, cell: RobotCell, hand: Hand, obj: ObjectModel | None = None):
        """obj: object for ``distance_to_object``; none if None."""
        spec = mount(hand, cell.arm.model, cell.mount)
        base = spec.worldbody.first_body()
        base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
        spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2, 2, 0.1])
        for number, box in enumerate(cell.obstacles):
            half, turn = 0.5 * np.array(box.size), list(box.rotation)
            kind, name = mujoco.mjtGeom.mjGEOM_BOX, f"{OBSTACLE} {number}"
            spec.worldbody.add_geom(name=name, type=kind, size=half, pos=list(box.center), quat=turn)
        if obj is not None:
            _add_object(spec, obj)
        for geom in spec.geoms:
            geom.margin = 0.5 * MARGIN
        # Base and shoulder stand on the table, and may touch obstacles.
        for body in ("base_link", "base_link_inertia", "shoulder_link"):
            spec.add_exclude(bodyname1="world", bodyname2=body)
        self._model = model = spec.compile()
        self._data = mujoco.MjData(model)
        self._hand = hand
        arm = [actuator.name for actuator in arm_spec(cell.arm.model).actuators]
        self._arm_qpos = np.array([model.joint(name).qposadr[0] for name in arm])
        self._hand_qpos = np.array([model.joint(name).qposadr[0] for name in hand.joint_names])
        kind = np.ones(model.nbody, dtype=int)
        kind[subtree(model, model.body(hand.palm).id)], kind[0] = 2, 0
        self._object: int | None = None
        if obj is not None:
            kind[model.body(OBJECT).id] = 0
            self._object = model.geom(OBJECT).id
        self._kind = kind[model.geom_bodyid]
        """Kind of each geom: -1 obstacle, 0 table or object, 1 arm, 2 hand."""
        for number in range(len(cell.obstacles)):
            self._kind[model.geom(f"{OBSTACLE} {number}").id] = -1

    def measure(self, arm: np.ndarray, fingers: np.ndarray) -> Clearance:
        """Measure a posture. arm: [rad], shape [M]; fingers: independent joints [rad], shape [U]."""
        m, d = self._model, self._data
        d.qpos[self._arm_qpos] = arm
        d.qpos[self._hand_qpos] = self._hand.all_joints(fingers)
        mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        if not d.ncon:
            return Clearance()
        distance = d.contact.dist
        low, high = np.sort(self._kind[d.contact.geom], axis=1).T

        def least(which: np.ndarray) -> float:
            return float(min(MARGIN, distance[which].min(initial=MARGIN)))

        return Clearance(
            table=least((low == 0) & (high == 1)),
            hand=least((low == 0) & (high == 2)),
            itself=least(low == 1),
            obstacle=least(low == -1),
        )

    def place_object(self, pose: np.ndarray) -> None:
        """Place the object, from the next measurement on. pose: world frame, shape [7]."""
        self._data.mocap_pos[0], self._data.mocap_quat[0] = pose[:3], pose[3:]

    def distance_to_object(self) -> float:
        """Return the distance of arm and hand, in the posture measured last, from the convex hull of the
        object [m], at most ``MARGIN``; negative for penetration."""
        m, d, obj = self._model, self._data, self._object
        assert obj is not None, "made without an object"
        reach = m.geom_rbound + m.geom_rbound[obj]
        near = np.linalg.norm(d.geom_xpos - d.geom_xpos[obj], axis=1) - reach < MARGIN
        rows = np.flatnonzero(near & (self._kind >= 1))
        return min(
            (float(mujoco.mj_geomDistance(m, d, int(row), obj, MARGIN, None)) for row in rows),
            default=MARGIN,
        )


def _add_object(spec: mujoco.MjSpec, obj: ObjectModel) -> None:
    """Add the convex hull of an object, without collisions."""
    hull = convex_hull(obj.vertices)
    mesh = spec.add_mesh(name=OBJECT)
    mesh.uservert, mesh.userface = hull.vertices.ravel().tolist(), hull.faces.ravel().tolist()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    body = spec.worldbody.add_body(name=OBJECT, mocap=True)
    body.add_geom(name=OBJECT, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=OBJECT, contype=0, conaffinity=0)
