"""A hand without any engine: bodies, joints, servos, shapes and couplings, as a compiled model has them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.simulation.scene import HAND_PREFIX

Vector = tuple[float, ...]

_SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_MESH): "convex",
}


@dataclass(frozen=True)
class Shape:
    """What of a body touches, body frame."""

    kind: str
    """"box", "capsule", "sphere", "cylinder" (along z) or "convex"."""
    size: Vector
    """Half extents of a box; radius and half length; empty for convex solids [m]."""
    pose: Vector
    """Body frame, 7 numbers."""
    vertices: tuple[Vector, ...] = ()
    """Corners of a convex solid [m], shape frame."""


@dataclass(frozen=True)
class Inertia:
    """Mass and where it is."""

    mass: float
    """[kg]."""
    center: Vector
    """Center of mass [m], body frame."""
    tensor: tuple[Vector, ...]
    """About that center, axes of the body frame [kg m2], 3 by 3."""


@dataclass(frozen=True)
class Joint:
    """A hinge or a slide at the origin of its body."""

    name: str
    """Name without the scene's prefix."""
    slide: bool
    """Whether it slides; otherwise it turns."""
    axis: Vector
    """Body frame."""
    limits: Vector
    """Lowest and highest position [rad] or [m]; empty without."""
    damping: float
    """[N m s/rad] or [N s/m]."""
    armature: float
    """Inertia of the drive [kg m2] or [kg]."""
    friction: float
    """Dry friction [N m]; engines that have none leave it out."""
    servo: Vector = ()
    """Stiffness, damping and largest force of its position servo; empty without."""


@dataclass(frozen=True)
class Body:
    """A link of the hand, or of the floating wrist."""

    name: str
    """Name without the scene's prefix."""
    parent: str
    """Name of a body that comes earlier; "" for the wrist's reference frame."""
    pose: Vector
    """Of the body in its parent, 7 numbers."""
    inertia: Inertia
    """Of the body, body frame."""
    joints: tuple[Joint, ...]
    """From the parent on; none for a body that is fixed to it."""
    shapes: tuple[Shape, ...]
    """What of it touches."""


@dataclass(frozen=True)
class CoupledJoints:
    """A joint that moves with another: ``follower = offset + ratio * leader``."""

    follower: str
    """Name of the joint that follows."""
    leader: str
    """Name of the joint that it follows."""
    offset: float
    """[rad]."""
    ratio: float
    """Of the two positions."""


def short(name: str) -> str:
    """Name of a part of the hand without what the scene puts before it."""
    return name.removeprefix(HAND_PREFIX)


def vector(values: np.ndarray) -> Vector:
    """Numbers as a record holds them."""
    return tuple(map(float, values))


def rows(values: np.ndarray) -> tuple[Vector, ...]:
    """Rows of numbers likewise."""
    return tuple(vector(row) for row in values)


def hand_bodies(model: mujoco.MjModel) -> tuple[Body, ...]:
    """The floating wrist and the hand, parents first."""
    root = model.body("wrist").id
    inside = [b for b in range(root, model.nbody) if model.body_rootid[b] == model.body_rootid[root]]
    servos = {int(model.actuator_trnid[a, 0]): a for a in range(model.nu)}
    result = []
    for b in inside:
        first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[b])
        axes = turn.reshape(3, 3)
        parent = int(model.body_parentid[b])
        result.append(
            Body(
                name=short(model.body(b).name),
                parent=short(model.body(parent).name) if parent in inside else "",
                pose=vector(np.concatenate([model.body_pos[b], model.body_quat[b]])),
                inertia=Inertia(
                    float(model.body_mass[b]),
                    vector(model.body_ipos[b]),
                    rows(axes @ np.diag(model.body_inertia[b]) @ axes.T),
                ),
                joints=tuple(_joint(model, j, servos.get(j)) for j in range(first, first + count)),
                shapes=_shapes(model, b),
            )
        )
    return tuple(result)


def _joint(model: mujoco.MjModel, j: int, servo: int | None) -> Joint:
    dof = int(model.jnt_dofadr[j])
    name = short(model.joint(j).name)
    if np.any(np.abs(model.jnt_pos[j]) > 1e-9):
        raise FungraspError(
            f"joint '{name}' is away from its body's origin: other engines are not told of that"
        )
    drive: Vector = ()
    if servo is not None:
        gain, bias = model.actuator_gainprm[servo], model.actuator_biasprm[servo]
        drive = (float(gain[0]), float(-bias[2]), float(model.actuator_forcerange[servo, 1]))
    return Joint(
        name=name,
        slide=bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE),
        axis=vector(model.jnt_axis[j]),
        limits=vector(model.jnt_range[j]) if model.jnt_limited[j] else (),
        damping=float(np.ravel(model.dof_damping[dof])[0]),
        armature=float(model.dof_armature[dof]),
        friction=float(model.dof_frictionloss[dof]),
        servo=drive,
    )


def _shapes(model: mujoco.MjModel, body: int) -> tuple[Shape, ...]:
    result = []
    first = int(model.body_geomadr[body])
    for g in range(first, first + int(model.body_geomnum[body])):
        if not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        kind, vertices = _SHAPES[int(model.geom_type[g])], ()
        if kind == "convex":
            mesh = int(model.geom_dataid[g])
            start = int(model.mesh_vertadr[mesh])
            vertices = rows(model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])])
        size = {"box": 3, "capsule": 2, "cylinder": 2, "sphere": 1, "convex": 0}[kind]
        pose = vector(np.concatenate([model.geom_pos[g], model.geom_quat[g]]))
        result.append(Shape(kind, vector(model.geom_size[g, :size]), pose, vertices))
    return tuple(result)


def hand_couplings(name: str, model: mujoco.MjModel) -> tuple[CoupledJoints, ...]:
    """Joints that move with others.

    Raises:
        FungraspError: some do in a way that other engines are not told of.
    """
    result = []
    for e in range(model.neq):
        offset, ratio, *higher = model.eq_data[e, :5].tolist()
        if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or any(higher):
            raise FungraspError(f"{name}: the hand is coupled in a way that other engines are not told of")
        follower, leader = (model.joint(int(j)).name for j in (model.eq_obj1id[e], model.eq_obj2id[e]))
        result.append(CoupledJoints(short(follower), short(leader), offset, ratio))
    return tuple(result)


def hand_apart(model: mujoco.MjModel) -> tuple[tuple[str, str], ...]:
    """Excluded pairs. MuJoCo leaves out parents and children as well; so does each engine here."""
    pairs = [(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature]
    return tuple((short(model.body(a).name), short(model.body(b).name)) for a, b in pairs)
