"""All that another physics engine needs to play a recorded episode again: the hand as a compiled model has
it, the object, what the servos were told, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.trajectory import PHASES, Trajectory
from fungrasp.geometry.poses import relative, transform_points
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.simulation import build_scene
from fungrasp.simulation.scene import HAND_PREFIX, Scene
from fungrasp.task.use import TABLE_AWAY, displacement, moved_too_far

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


@dataclass(frozen=True)
class EpisodeBundle:
    """A recorded episode of the lift test, or of a use test in which only the hand moves. Poses are
    in the world frame: z up, table top of the lift test at z = 0."""

    name: str
    """Of the recording."""
    palm: str
    """Name of the palm's body."""
    links: tuple[tuple[str, ...], ...]
    """Bodies of each contact link."""
    bodies: tuple[Body, ...]
    """Of the floating wrist and the hand, parents first."""
    couplings: tuple[CoupledJoints, ...]
    """Joints that move with others."""
    apart: tuple[tuple[str, str], ...]
    """Pairs of bodies that do not collide."""
    object_name: str
    """Name of the object."""
    object_inertia: Inertia
    """Of the object, object frame."""
    pieces: tuple[tuple[Vector, ...], ...]
    """Corners of the object's convex pieces [m], object frame."""
    gravity: float
    """[m/s^2]; the hand's weight is compensated."""
    friction: float
    """Sliding friction of hand, object and table."""
    torsional_friction: float
    """Of all contacts, where an engine has it [m]."""
    timestep: float
    """Physics step of the own engine [s]."""
    wrist_reference: Vector
    """Frame in which the wrist's joints count, 7 numbers."""
    servos: tuple[str, ...]
    """Joints that have one, in the order of the setpoints."""
    start: Mapping[str, float]
    """Position of every joint at the start [rad] or [m]."""
    object_pose: Vector
    """Where the object rests at the start, 7 numbers."""
    period: float
    """Time between two setpoints [s]."""
    setpoints: tuple[Vector, ...]
    """The first is that of the start."""
    lift_time: float
    """When the lift began [s]; infinity is written as -1."""
    hold_time: float
    """Likewise the hold."""
    success: bool
    """Whether the object was lifted and held."""
    reason: str
    """Why not."""
    poses_in_palm: tuple[Vector, ...]
    """Of the object, after each setpoint, 7 numbers each."""
    contacts: tuple[tuple[bool, ...], ...]
    """Which links touched the object then."""
    table_height: float = 0.0
    """Of the table top [m]."""
    use: bool = False
    """Whether it is of a use test, in which the object has to stay where it is in the palm."""

    @cached_property
    def center(self) -> np.ndarray:
        """Center of mass of the object [m], object frame, shape [3]."""
        return np.array(self.object_inertia.center)

    @cached_property
    def told(self) -> np.ndarray:
        """The setpoints, shape [1 + S, J]."""
        return np.array(self.setpoints)


def make_bundle(name: str, recorded: Trajectory, scene: Scene) -> EpisodeBundle:
    """The bundle of a recorded episode.

    Args:
        name: of the recording.
        recorded: in a nominal world, with what the servos were told. A use test succeeds here where the
            object stays in the palm, wherever the hand touches it.
        scene: of its hand and its object.

    Raises:
        FungraspError: the recording lacks something, or the hand has what other engines are not told of.
    """
    if recorded.controls is None:
        raise FungraspError(
            f"{name} does not hold what the servos were told: record it anew, or leave it out where it is "
            "of a use test in which the world pushes or pulls at the object"
        )
    if recorded.differs:
        raise FungraspError(
            f"{name} is of a world in which these differ from the nominal one, which is not recorded: "
            f"{recorded.differs}"
        )
    model, hand = scene.model, scene.hand
    obj = scene.models[scene.indices([recorded.object_name])[0]]
    servos = np.concatenate([scene.wrist_actuators, scene.finger_actuators])
    driven = [model.joint(int(model.actuator_trnid[servo, 0])).name for servo in servos]
    joints = [
        model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE
    ]
    begins = [recorded.times[recorded.phase >= PHASES.index(p)] for p in ("lift", "hold")]
    lift, hold = (float(times[0]) if len(times) else -1.0 for times in begins)
    in_palm, success, reason = _in_palm(recorded), recorded.success, recorded.reason
    if recorded.is_use_test:
        lift = hold = 0.0
        reason = moved_in_palm(in_palm[0], in_palm[1:], obj.center_of_mass)
        success = not reason
    return EpisodeBundle(
        name=name,
        palm=hand.palm,
        links=tuple(tuple(members) for members in hand.links),
        bodies=hand_bodies(model),
        couplings=hand_couplings(name, model),
        apart=hand_apart(model),
        object_name=recorded.object_name,
        object_inertia=Inertia(
            recorded.object_mass,
            vector(obj.center_of_mass),
            rows(obj.inertia * (recorded.object_mass / obj.mass)),
        ),
        pieces=tuple(rows(piece.vertices) for piece in obj.pieces),
        gravity=scene.settings.gravity,
        friction=scene.settings.friction,
        torsional_friction=scene.settings.torsional_friction,
        timestep=scene.settings.timestep,
        wrist_reference=vector(recorded.wrist_reference),
        servos=tuple(short(joint) for joint in driven),
        start={short(j): float(recorded.qpos[0, model.joint(j).qposadr[0]]) for j in joints},
        object_pose=vector(recorded.object_pose[0]),
        period=float(np.median(np.diff(recorded.times))),
        setpoints=rows(recorded.controls),
        lift_time=lift,
        hold_time=hold,
        success=success,
        reason=reason,
        poses_in_palm=rows(in_palm[1:]),
        contacts=tuple(tuple(map(bool, row)) for row in recorded.link_contacts[1:]),
        table_height=TABLE_AWAY if recorded.is_use_test else 0.0,
        use=recorded.is_use_test,
    )


def moved_in_palm(start: np.ndarray, poses: np.ndarray, center: np.ndarray) -> str:
    """Why an object has not stayed in the palm during a use test, "" if it has.

    Args:
        start: its pose there when the motion began, shape [7].
        poses: and during it, shape [T, 7].
        center: of its mass, object frame [m], shape [3].
    """
    centers = transform_points(np.stack([start, *poses]), center[None, None])[:, 0]
    shift, turn = displacement((centers[0], start[3:]), (centers[1:], poses[:, 3:]))
    return moved_too_far(float(shift.max()), float(turn.max()))


def scene_of(recorded: Trajectory, objects: Mapping[str, ObjectModel]) -> Scene:
    """The scene of a recording. objects: by name, its own among them."""
    name = recorded.object_name
    return build_scene(load_hand(recorded.hand), {name: objects[name]})


def _in_palm(recorded: Trajectory) -> np.ndarray:
    """The object's poses in the palm, shape [T, 7]."""
    return relative(recorded.palm_pose.astype(float), recorded.object_pose.astype(float))
