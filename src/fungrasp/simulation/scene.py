"""One scene for a hand and several objects: a table, a floating hand, an object with a fixed number of geom
slots, sensors.

The table of per-object model fields allows a different object in each world of a batch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.objects.object_model import GRAVITY
from fungrasp.simulation.devices import BufferSizes, Device

WRIST_JOINTS = ("wrist_x", "wrist_y", "wrist_z", "wrist_roll", "wrist_pitch", "wrist_yaw")
"""Three slides and three hinges between the wrist's reference frame (a mocap body) and the palm."""

HAND_PREFIX = "hand/"
"""Prefix of the names of the hand's bodies, joints and actuators."""

NOMINAL_FRICTION = 0.9
"""Default sliding friction of hand, object and table (docs/evaluate.md)."""

_DATA = mujoco.mjtConDataField


@dataclass(frozen=True)
class SceneSettings(CheckedRecord):
    """Physics of the lift test (docs/evaluate.md)."""

    timestep: float = 0.005
    """Physics step [s]."""
    gravity: float = GRAVITY
    """Downward acceleration [m/s^2]."""
    friction: float = NOMINAL_FRICTION
    """Sliding friction of hand, object and table."""
    torsional_friction: float = 0.005
    """Coefficient of torsional friction of all contacts [m]."""
    impratio: float = 10.0
    """Ratio of frictional to normal constraint impedance; above 1 it reduces slip (MuJoCo's ``impratio``)."""
    iterations: int = 10
    """Largest number of Newton iterations per step."""
    noslip_iterations: int = 0
    """Iterations that reduce frictional creep. They slow down physics and change few outcomes
    (docs/how-it-works.md). Not available on a GPU."""
    wrist_stiffness: tuple[float, float] = (2000.0, 100.0)
    """Stiffness of the wrist servo for position [N/m] and rotation [N m/rad]. A robot arm is stiffer; this
    keeps collisions soft."""
    wrist_damping: tuple[float, float] = (120.0, 5.0)
    """Damping of the wrist servo for position [N s/m] and rotation [N m s/rad]."""
    wrist_force: tuple[float, float] = (100.0, 15.0)
    """Largest force [N] and torque [N m] of the wrist servo; a UR5e carries 5 kg."""
    device: Device = "cpu"
    """Device of the simulation (docs/train.md)."""
    buffers: BufferSizes | None = None
    """Contact buffers on a GPU; determined by a probe if None."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene.

    Sensors in ``sensordata`` of each world: contact count and net force between each member body of each
    contact link and the object, then the same with the table, then of the object with the table, then of the
    hand with itself."""

    hand: Hand
    """The robot hand."""
    model: mujoco.MjModel
    """The compiled model, with the first object's fields."""
    objects: tuple[str, ...]
    """Names of the objects; each world has one of them."""
    fields: Mapping[str, np.ndarray]
    """Model fields that differ between objects, shape [number of objects, ...]."""
    settings: SceneSettings
    """Settings of the physics."""
    models: tuple[ObjectModel, ...]
    """The objects, in the order of ``objects``."""

    def indices(self, names: Iterable[str]) -> np.ndarray:
        """Return indices of objects by name (``object_index`` of engines), shape [N] int.

        Raises:
            FungraspError: an object is not in the scene.
        """
        known = {name: i for i, name in enumerate(self.objects)}
        wanted = list(names)
        unknown = sorted({name for name in wanted if name not in known})
        if unknown:
            raise FungraspError(f"the scene holds no {', '.join(unknown)}; it holds {', '.join(known)}")
        return np.array([known[name] for name in wanted])

    @property
    def wrist_actuators(self) -> np.ndarray:
        """Actuator ids of the six wrist joints."""
        return np.array([self.model.actuator(name).id for name in WRIST_JOINTS])

    @property
    def finger_actuators(self) -> np.ndarray:
        """Actuator ids of the hand's independent joints, in ``Hand.actuators`` order."""
        return np.array([self.model.actuator(HAND_PREFIX + name).id for name in self.hand.actuators])

    @property
    def servo_limits(self) -> np.ndarray:
        """Lowest and highest target of each finger servo [rad], shape [U, 2]."""
        return self.model.actuator_ctrlrange[self.finger_actuators]


def build_scene(
    hand: Hand | str | Path, objects: Mapping[str, ObjectModel], settings: SceneSettings | None = None
) -> Scene:
    """Compile a scene with a hand and objects.

    Args:
        hand: robot hand, its name, or the path of its TOML file.
        objects: objects by name.

    Raises:
        FungraspError: the hand is unknown, there is no object, or the scene does not compile.
    """
    hand = as_hand(hand)
    check_objects((), objects)
    if not objects:
        raise FungraspError("a scene needs at least one object")
    settings = SceneSettings.given(settings)
    slots = max(len(model.pieces) for model in objects.values())
    names = tuple(objects)
    whole = _compile(hand, objects, names[0], slots, settings)
    single = [_compile(hand, {name: objects[name]}, name, slots, settings) for name in names]
    fields = _differing_fields(whole, single)
    fields["geom_dataid"] = np.stack(
        [
            np.array(
                [_mesh_id(whole, model, mesh) for mesh in model.geom_dataid], dtype=whole.geom_dataid.dtype
            )
            for model in single
        ]
    )
    return Scene(hand, whole, names, fields, settings, tuple(objects.values()))


def _compile(
    hand: Hand, objects: Mapping[str, ObjectModel], shown: str, slots: int, settings: SceneSettings
) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.modelname = f"{hand.name} scene"
    _set_options(spec, settings)
    friction = [settings.friction, settings.torsional_friction, 0.0001]
    table = spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.75, 0.75, 0.05], rgba=[0.72, 0.66, 0.58, 1.0]
    )
    table.friction, table.condim = friction, 4
    _add_object(spec, objects, shown, slots, friction)
    _add_hand(spec, hand, settings, friction)
    _add_sensors(spec, hand)
    try:
        return spec.compile()
    except ValueError as error:
        raise FungraspError(
            f"the scene of hand '{hand.name}' does not compile: {' '.join(str(error).split())}"
        ) from error


def _set_options(spec: mujoco.MjSpec, settings: SceneSettings) -> None:
    option = spec.option
    option.timestep = settings.timestep
    option.gravity = [0.0, 0.0, -settings.gravity]
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = settings.impratio
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.iterations = settings.iterations
    option.noslip_iterations = settings.noslip_iterations
    option.ls_iterations = 20
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE


def _add_object(
    spec: mujoco.MjSpec, objects: Mapping[str, ObjectModel], shown: str, slots: int, friction: list[float]
) -> None:
    for name, model in objects.items():
        for i, piece in enumerate(model.pieces):
            mesh = spec.add_mesh(name=f"{name}/{i}")
            mesh.uservert = piece.vertices.ravel().tolist()
            mesh.userface = piece.faces.ravel().tolist()
            # MuJoCo creates convex hulls only for meshes of this model's geoms or with convex inertia.
            # Without hulls, a pair of geoms has at most one contact.
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    model = objects[shown]
    body = spec.worldbody.add_body(name="object", pos=[0.0, 0.0, 0.5])
    body.add_freejoint(name="object")
    body.mass, body.ipos, body.explicitinertial = model.mass, _off_origin(model.center_of_mass), True
    inertia = model.inertia
    body.fullinertia = [
        inertia[0, 0],
        inertia[1, 1],
        inertia[2, 2],
        inertia[0, 1],
        inertia[0, 2],
        inertia[1, 2],
    ]
    for i in range(slots):
        used = i < len(model.pieces)
        geom = body.add_geom(
            name=f"object/{i}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{shown}/{i if used else 0}",
            mass=0.0,
            rgba=[0.45, 0.62, 0.78, 1.0 if used else 0.0],
        )
        geom.friction, geom.condim = friction, 4
        geom.contype = geom.conaffinity = int(used or len(objects) > 1)


def _off_origin(center: np.ndarray) -> np.ndarray:
    """Return the center of mass, moved at least a micrometer away from the body's origin.

    MuJoCo stores the inertia of a body with its center of mass at its origin in a smaller layout, which can't
    differ between worlds.
    """
    return center if np.linalg.norm(center) > 1e-6 else np.array([1e-6, 0.0, 0.0])


def _add_hand(spec: mujoco.MjSpec, hand: Hand, settings: SceneSettings, friction: list[float]) -> None:
    mocap = spec.worldbody.add_body(name="wrist_reference", mocap=True)
    wrist = mocap.add_body(name="wrist", mass=0.2, inertia=[1e-3, 1e-3, 1e-3])
    wrist.explicitinertial, wrist.gravcomp = True, 1.0
    axes = np.eye(3)
    for i, name in enumerate(WRIST_JOINTS):
        joint_type = mujoco.mjtJoint.mjJNT_SLIDE if i < 3 else mujoco.mjtJoint.mjJNT_HINGE
        part = 0 if i < 3 else 1
        # MuJoCo computes contact forces without damping and then adds damping implicitly, which acts like an
        # additional inertia of damping times timestep. If that exceeds the real inertia, contacts push a held
        # object ahead of the accelerating hand. An arm has this much inertia.
        inertia = settings.timestep * settings.wrist_damping[part]
        wrist.add_joint(name=name, type=joint_type, axis=axes[i % 3], armature=inertia)
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=settings.wrist_stiffness[part], kv=settings.wrist_damping[part])
        actuator.forcelimited = True
        actuator.forcerange = [-settings.wrist_force[part], settings.wrist_force[part]]
    hand_spec = hand.spec()
    for body in hand_spec.bodies:
        body.gravcomp = 1.0
    for geom in hand_spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.friction, geom.condim = friction, 4
    frame = wrist.add_frame()
    spec.attach(hand_spec, frame=frame, prefix=HAND_PREFIX)


def _add_sensors(spec: mujoco.MjSpec, hand: Hand) -> None:
    body = mujoco.mjtObj.mjOBJ_BODY
    found_and_force = (1 << int(_DATA.mjCONDATA_FOUND)) | (1 << int(_DATA.mjCONDATA_FORCE))
    for members in hand.links:
        for name in members:
            _contact_sensor(
                spec, f"{name}/object", (body, HAND_PREFIX + name), (body, "object"), found_and_force
            )
    for members in hand.links:
        for name in members:
            _contact_sensor(
                spec,
                f"{name}/table",
                (body, HAND_PREFIX + name),
                (mujoco.mjtObj.mjOBJ_GEOM, "table"),
                found_and_force,
            )
    _contact_sensor(
        spec, "object/table", (body, "object"), (mujoco.mjtObj.mjOBJ_GEOM, "table"), found_and_force
    )
    subtree = (mujoco.mjtObj.mjOBJ_XBODY, HAND_PREFIX + hand.palm)
    _contact_sensor(spec, "hand/hand", subtree, subtree, found_and_force)


def _contact_sensor(
    spec: mujoco.MjSpec,
    name: str,
    first: tuple[mujoco.mjtObj, str],
    second: tuple[mujoco.mjtObj, str],
    data: int,
) -> None:
    net_force = 3
    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT)
    sensor.objtype, sensor.objname = first
    sensor.reftype, sensor.refname = second
    sensor.intprm = [data, net_force, 1]


def _differing_fields(whole: mujoco.MjModel, models: list[mujoco.MjModel]) -> dict[str, np.ndarray]:
    """Return the model fields that differ between objects and can differ between worlds."""
    result = {}
    for name in sorted(MODEL_FIELDS):
        if name.startswith(("opt.", "mesh_", "bvh_", "body_bvh", "name_")) or not hasattr(whole, name):
            continue
        values = [getattr(model, name) for model in models]
        shape = np.shape(getattr(whole, name))
        if all(np.shape(v) == shape for v in values) and any(
            not np.array_equal(v, values[0]) for v in values
        ):
            result[name] = np.stack([np.array(v) for v in values])
    return result


def _mesh_id(whole: mujoco.MjModel, model: mujoco.MjModel, mesh: int) -> int:
    return whole.mesh(model.mesh(int(mesh)).name).id if mesh >= 0 else -1
