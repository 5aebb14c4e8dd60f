"""MuJoCo model of a twin: arm, hand, table and object, with other contact parameters than the planner's."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
import trimesh

from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec, mount
from fungrasp.objects import ObjectModel
from fungrasp.objects.convex_decomposition import (
    ConvexPiece,
    DecompositionSettings,
    convex_hull,
    convex_pieces,
)
from fungrasp.objects.object_model import GRAVITY
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.twin.parameters import TwinParameters, twin_torque_limits

OBJECT, TABLE = "twin_object", "twin_table"
"""Names of the object's body and of the table's geom."""

SERVO_LARGE, SERVO_WRIST = 10000.0, 1500.0
"""Stiffness of the arm's three large and three small servos [N m/rad]."""

SERVO_LAG = 0.02
"""Ratio of the arm servos' damping to their stiffness [s]. With ``arm_delay``, targets are followed 35 ms
late, as by a UR10e with servoj and the shortest lookahead (Universal_Robots_Client_Library, issue 86)."""

OTHER_PIECES = DecompositionSettings(concavity=0.007, fine_concavity=0.004, max_pieces=16, seed=7)
"""Fewer and coarser convex pieces than the planner's."""


@dataclass(frozen=True)
class TwinPhysics:
    """Physics of a twin; each number differs from the planner's (``fungrasp.simulation.SceneSettings``)."""

    timestep: float = 0.002
    """Physics step [s]."""
    impratio: float = 5.0
    """Ratio of frictional to normal constraint impedance."""
    noslip_iterations: int = 3
    """Iterations against the slow slip of contacts, which is an artifact of the solver."""
    contact_time: float = 0.008
    """Time constant of contacts (MuJoCo's ``solref``) [s]."""
    pieces: DecompositionSettings = field(default_factory=lambda: OTHER_PIECES)
    """Convex decomposition of objects."""


def twin_model(cell: RobotCell, hand: Hand, obj: ObjectModel, truth: TwinParameters) -> mujoco.MjModel:
    """Compile the model, in the cell's world frame. obj: believed model of the object."""
    p = TwinPhysics()
    spec = mount(hand, cell.arm.model, cell.mount)
    option = spec.option
    option.timestep, option.impratio = p.timestep, p.impratio
    # Equal friction in all directions: a pyramidal cone with coefficient 0.8 has only 0.57 along its
    # diagonal, and half of that under torsion.
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.noslip_iterations, option.gravity = p.noslip_iterations, [0.0, 0.0, -GRAVITY]
    base = spec.worldbody.first_body()
    base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
    _add_table(spec, truth)
    _add_object(spec, obj, truth, p)
    _stiffen_arm(spec, {actuator.name for actuator in arm_spec(cell.arm.model).actuators})
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.friction = [truth.object_friction, 0.005, 0.0001]
            geom.condim = 4
            geom.solref = [p.contact_time, 1.0]
    # The arm stands on the table.
    spec.add_exclude(bodyname1="world", bodyname2="base_link_inertia")
    model = spec.compile()
    _set_hand(model, hand, truth, twin_torque_limits(cell, hand))
    return model


def _stiffen_arm(spec: mujoco.MjSpec, names: set[str]) -> None:
    """Stiffen the arm's servos, which are soft in the planner's model. names: actuators of the arm."""
    for actuator in spec.actuators:
        if actuator.name in names:
            stiffness = SERVO_LARGE if actuator.forcerange[1] > 100 else SERVO_WRIST
            actuator.set_to_position(kp=stiffness, kv=SERVO_LAG * stiffness)


def _add_table(spec: mujoco.MjSpec, truth: TwinParameters) -> None:
    table = spec.worldbody.add_geom(
        name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.75, 0.75, 0.05], rgba=[0.72, 0.66, 0.58, 1.0]
    )
    table.pos = [0.0, 0.0, truth.table_height]
    table.quat = quaternion_from_rotation_vector(truth.table_tilt)


def _add_object(spec: mujoco.MjSpec, obj: ObjectModel, truth: TwinParameters, p: TwinPhysics) -> None:
    body = spec.worldbody.add_body(name=OBJECT, pos=[0.0, 0.0, 0.5])
    body.add_freejoint(name=OBJECT)
    mass = obj.mass * truth.mass
    body.mass, body.explicitinertial = mass, True
    center = obj.center_of_mass + truth.center_of_mass * obj.size
    body.ipos = center
    i = obj.inertia * truth.mass
    body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    for number, piece in enumerate(true_pieces(obj, truth.spread.surface, p.pieces)):
        mesh = spec.add_mesh(name=f"{OBJECT}/{number}")
        mesh.uservert, mesh.userface = piece.vertices.ravel().tolist(), piece.faces.ravel().tolist()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        body.add_geom(
            name=f"{OBJECT}/{number}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            mass=0.0,
            rgba=[0.45, 0.62, 0.78, 1.0],
        )


def true_pieces(
    obj: ObjectModel, amplitude: float, settings: DecompositionSettings
) -> tuple[ConvexPiece, ...]:
    """Return convex pieces of the true surface: another decomposition than the planner's, displaced along the
    normals by a smooth wave with an amplitude [m] and a wavelength of about 4 cm."""
    if amplitude <= 0.0:
        return convex_pieces(obj.vertices, obj.faces, settings)
    # The wave is applied to the pieces, as those of the believed surface are cached.
    parts = []
    for piece in convex_pieces(obj.vertices, obj.faces, settings):
        mesh = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
        phase = np.sin(piece.vertices @ np.array([157.0, 113.0, 131.0]))
        parts.append(convex_hull(piece.vertices + amplitude * phase[:, None] * mesh.vertex_normals))
    return tuple(parts)


def _set_hand(model: mujoco.MjModel, hand: Hand, truth: TwinParameters, asked: np.ndarray) -> None:
    """Set the true parameters of the hand's servos and joints. asked: torque limits of the driver [N m],
    shape [U]; the true torque constant scales them."""
    constant = truth.stiffness / truth.gain
    for i, name in enumerate(hand.joint_names):
        dof = model.joint(name).dofadr[0]
        model.dof_damping[dof] *= truth.damping[i]
        model.dof_armature[dof] *= truth.armature[i]
    for i, name in enumerate(hand.actuators):
        actuator = model.actuator(name).id
        model.actuator_gainprm[actuator, 0] *= truth.stiffness[i]
        model.actuator_biasprm[actuator, 1:3] *= truth.stiffness[i]
        largest = min(model.actuator_forcerange[actuator, 1] * truth.torque_limit[i], asked[i] * constant[i])
        model.actuator_forcerange[actuator] = -largest, largest
