"""A dexterous hand: its kinematic model and the bodies that correspond to a human hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import digest
from fungrasp.core.formats.checks import guarded, one_line
from fungrasp.core.formats.mujoco_model import read_model
from fungrasp.core.formats.text_files import Schema, read_toml, type_faults
from fungrasp.geometry.arrays import constant
from fungrasp.geometry.poses import Array, invert
from fungrasp.hands.kinematic_tree import coupling_matrix, drives, place_of

_SERVO = {"kp": float, "kd": float, "force_limit": float}

HAND_TOML: Schema = {
    "name": str,
    "title": str,
    "model": str,
    "palm": str,
    "source": str,
    "palm_frame": {"fingers": [float], "normal": [float]},
    "fingers": {"*": {"links": [str], "joints": [str], "tip": str}},
    "actuators": {**_SERVO, "source": str, "joints": {"*": _SERVO}},
}
"""Fields of a hand's TOML file; ``side`` is checked by ``read_hand_toml``."""

FINGERS = ("index", "middle", "ring", "pinky", "thumb")
"""Finger names, in the order of the human joints and links (docs/concepts.md)."""


@dataclass(frozen=True)
class Finger:
    """One finger of a hand."""

    name: str
    """The corresponding human finger, one of ``FINGERS``."""
    links: tuple[str, ...]
    """One to three bodies from base to tip, for the human proximal, middle and distal links. With fewer
    bodies, the links near the tip are missing."""
    joints: tuple[str, ...]
    """Site or body at the near end of each link: by default the link's body."""
    tip: str
    """Site or body at the center of the rounded fingertip."""


@dataclass(frozen=True)
class Actuator:
    """Position servo of one independent joint."""

    joint: str
    """Joint name."""
    kp: float
    """Stiffness [N m/rad]."""
    kd: float
    """Damping [N m s/rad]."""
    force_limit: float
    """Largest torque [N m]."""
    joint_damping: float | None = None
    """Joint damping in addition to ``kd`` [N m s/rad]; None: from the model file."""
    joint_friction: float | None = None
    """Dry friction [N m]; None: from the model file."""
    joint_armature: float | None = None
    """Armature, the inertia of the drive at the joint [kg m^2]; None: from the model file."""


@dataclass(frozen=True, repr=False, eq=False)
class Hand:
    """A hand, as loaded by ``fungrasp.hands.load_hand``."""

    name: str
    """Name in commands and files."""
    title: str
    """Product name."""
    path: Path
    """TOML file."""
    model_path: Path
    """MJCF or URDF file."""
    palm: str
    """Body that carries the fingers; ``wrist_pose`` is its pose."""
    palm_fingers: np.ndarray
    """Unit vector from the wrist to the middle finger's base, palm frame, shape [3]."""
    palm_normal: np.ndarray
    """Unit vector out of the palm towards a held object, palm frame, shape [3]."""
    fingers: Mapping[str, Finger]
    """Fingers by name, in the order of ``FINGERS``."""
    actuators: Mapping[str, Actuator]
    """Servos by joint name, in the model's joint order."""
    side: str = "right"
    """Corresponding human hand, "right" or "left"."""
    source: str = ""
    """Source of the model."""
    dynamics_path: Path | None = None
    """File of identified dynamics; None: the model's dynamics."""

    def __repr__(self) -> str:
        counts = f"{len(self.fingers)} fingers, {len(self.actuators)} driven joints"
        return f"<Hand: {self.name!r}, {self.side}, {counts}>"

    def spec(self) -> mujoco.MjSpec:
        """Return a new model of the bare hand: palm fixed at the world's origin, one position actuator per
        independent joint with the joint's name."""
        spec = read_model(self.model_path)
        _put_at_origin(spec, self.palm)
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        for servo in self.actuators.values():
            joint = spec.joint(servo.joint)
            actuator = spec.add_actuator(
                name=servo.joint, target=servo.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_position(kp=servo.kp, kv=servo.kd)
            actuator.forcelimited = True
            actuator.forcerange = [-servo.force_limit, servo.force_limit]
            actuator.ctrllimited = True
            actuator.ctrlrange = joint.range
            if servo.joint_damping is not None:
                # Coefficients of linear, quadratic and cubic damping.
                joint.damping = [servo.joint_damping, 0.0, 0.0]
            if servo.joint_friction is not None:
                joint.frictionloss = servo.joint_friction
            if servo.joint_armature is not None:
                joint.armature = servo.joint_armature
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        """Compiled model of the bare hand. Do not modify it."""
        try:
            return self.spec().compile()
        except ValueError as error:
            raise FungraspError(f"hand '{self.name}' does not compile: {one_line(error)}") from error

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the TOML file, the model file and the servos, including identified values."""
        servos = {name: asdict(servo) for name, servo in self.actuators.items()}
        return digest(self.path.read_bytes(), self.model_path.read_bytes(), servos)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints of the model in order, including coupled joints, length M."""
        return tuple(self.model.joint(i).name for i in range(self.model.njnt))

    @property
    def joint_limits(self) -> np.ndarray:
        """Lower and upper limits [rad], shape [M, 2]; infinite for unlimited joints."""
        limited = self.model.jnt_limited[:, None].astype(bool)
        return np.where(limited, self.model.jnt_range, [[-np.inf, np.inf]])

    @cached_property
    def coupling(self) -> tuple[np.ndarray, np.ndarray]:
        """``joint_positions = matrix @ independent + offset`` [rad]; matrix: shape [M, U], offset: shape [M].

        The U independent joints are those that no joint equality drives, in model order. Only the linear part
        of an equality is used.
        """
        try:
            return coupling_matrix(self.model.njnt, drives(self.model))[:2]
        except ValueError as error:
            raise FungraspError(f"hand '{self.name}': in {self.model_path} {error}") from None

    @cached_property
    def _decoupling(self) -> np.ndarray:
        return np.linalg.pinv(self.coupling[0])

    def independent(self, joint_positions: Array) -> Array:
        """Return the independent joints [rad], shape [..., U], for all joints [rad], shape [..., M]: the
        least-squares solution if the joints violate the couplings."""
        offset, matrix = (constant(joint_positions, part) for part in (self.coupling[1], self._decoupling))
        return (joint_positions - offset) @ matrix.T

    def all_joints(self, independent: Array) -> Array:
        """Return all joints [rad], shape [..., M], for independent joints [rad], shape [..., U]."""
        matrix, offset = (constant(independent, part) for part in self.coupling)
        return independent @ matrix.T + offset

    @property
    def open_joints(self) -> np.ndarray:
        """Independent joints of the open hand: zero, or the limit nearest to zero [rad], shape [U]."""
        return self.independent(np.clip(np.zeros(len(self.joint_names)), *self.joint_limits.T))

    @property
    def index_side(self) -> np.ndarray:
        """Unit vector across the palm towards the index finger and thumb, palm frame, shape [3]."""
        across = np.cross(self.palm_fingers, self.palm_normal)
        return across if self.side == "right" else -across

    @property
    def links(self) -> tuple[tuple[str, ...], ...]:
        """Bodies of each contact link, length L: the palm, then each finger's links. A body that the TOML
        file does not name belongs to its nearest named ancestor, or else to the palm."""
        named = [self.palm, *(body for finger in self.fingers.values() for body in finger.links)]
        members: dict[str, list[str]] = {body: [] for body in named}
        m = self.model
        for body in range(1, m.nbody):
            owner = body
            while owner and m.body(owner).name not in members:
                owner = int(m.body_parentid[owner])
            members[m.body(owner).name if owner else self.palm].append(m.body(body).name)
        return tuple(tuple(members[body]) for body in named)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the contact links, "palm", "index_proximal", ..., length L."""
        parts = ("proximal", "middle", "distal")
        names = [f"{f.name}_{parts[i]}" for f in self.fingers.values() for i in range(len(f.links))]
        return ("palm", *names)

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """Sites or bodies of the key points, length K: the palm, then each finger's joints and tip."""
        return (self.palm, *(name for f in self.fingers.values() for name in (*f.joints, f.tip)))


@guarded("hand file")
def read_hand_toml(path: Path) -> Hand:
    """Read a hand's TOML file and check that its names exist in the model.

    Raises:
        FungraspError: the file or its model is missing, unreadable or inconsistent.
    """
    data = read_toml(path, "hand file")
    for fault in type_faults(data, HAND_TOML):
        raise FungraspError(f"{path}: {fault}")
    for key in ("name", "model", "palm", "fingers", "actuators"):
        if key not in data:
            raise FungraspError(f"{path}: the field '{key}' is missing")
    model_path = path.parent / data["model"]
    spec = read_model(model_path)
    try:
        model = spec.compile()
    except ValueError as error:
        raise FungraspError(f"{model_path} does not compile: {one_line(error)}") from error
    bodies = {model.body(i).name for i in range(model.nbody)}
    sites = {model.site(i).name for i in range(model.nsite)}

    def existing(kind: str, name: str, known: set[str]) -> str:
        if name not in known:
            raise FungraspError(f"{path}: {UnknownNameError(f'{kind} of {model_path.name}', name, known)}")
        return name

    unknown = set(data["fingers"]) - set(FINGERS)
    if unknown:
        raise FungraspError(f"{path}: {UnknownNameError('finger', sorted(unknown)[0], FINGERS)}")
    fingers = {}
    for name in FINGERS:
        if name not in data["fingers"]:
            continue
        entry = data["fingers"][name]
        if not 1 <= len(entry.get("links", ())) <= 3 or "tip" not in entry:
            raise FungraspError(
                f"{path}: finger '{name}' needs 'links' (one to three bodies, base to tip) and 'tip' (a site "
                "or body)"
            )
        links = tuple(existing("body", link, bodies) for link in entry["links"])
        joints = tuple(
            existing("site or body", joint, sites | bodies) for joint in entry.get("joints", links)
        )
        if len(joints) != len(links):
            raise FungraspError(
                f"{path}: finger '{name}' has {len(links)} links and {len(joints)} joints; give one each"
            )
        fingers[name] = Finger(name, links, joints, existing("site or body", entry["tip"], sites | bodies))
    if "thumb" not in fingers:
        raise FungraspError(f"{path}: a hand with no thumb can't imitate a human grasp; give [fingers.thumb]")
    if len(fingers) < 2:
        raise FungraspError(f"{path}: a hand needs a thumb and at least one more finger")
    frame = data.get("palm_frame", {})
    palm_fingers = _unit(path, "palm_frame.fingers", frame.get("fingers", (0, 0, 1)))
    palm_normal = _unit(path, "palm_frame.normal", frame.get("normal", (1, 0, 0)))
    palm = existing("body", data["palm"], bodies)
    side = data.get("side", side_of(model, palm, fingers, np.cross(palm_fingers, palm_normal)))
    if side not in ("right", "left"):
        raise FungraspError(f'{path}: side must be "right" or "left", not {side!r}')
    return Hand(
        name=data["name"],
        title=data.get("title", data["name"]),
        path=path,
        model_path=model_path,
        palm=palm,
        palm_fingers=palm_fingers,
        palm_normal=palm_normal,
        fingers=fingers,
        actuators=_actuators(path, data["actuators"], model),
        side=side,
        source=data.get("source", ""),
    )


def side_of(model: mujoco.MjModel, palm: str, fingers: Mapping[str, Finger], across: np.ndarray) -> str:
    """Return whether a hand is "right" or "left".

    On a right hand, the first finger's base lies farther along ``across`` than that of the last finger. On a
    right hand with one finger, the thumb's base lies farther than that of the finger.

    Args:
        fingers: fingers by name, in the order of ``FINGERS``.
        across: cross product of ``palm_fingers`` and ``palm_normal``, palm frame, shape [3].
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    direction = data.body(palm).xmat.reshape(3, 3) @ across

    def base(finger: Finger) -> float:
        return float(place_of(data, finger.joints[0]) @ direction)

    first, *others = (fingers[name] for name in fingers if name != "thumb")
    difference = base(first) - base(others[-1]) if others else base(fingers["thumb"]) - base(first)
    return "left" if difference < 0 else "right"


def _actuators(path: Path, entry: Mapping[str, Any], model: mujoco.MjModel) -> dict[str, Actuator]:
    joints = [model.joint(i).name for i in range(model.njnt)]
    driven = {model.joint(joint).name for joint in drives(model)}
    special = entry.get("joints", {})
    for joint in special:
        if joint not in joints:
            raise FungraspError(f"{path}: {UnknownNameError('joint', joint, joints)}")
    actuators = {}
    for joint in joints:
        if joint in driven:
            continue
        values = {}
        for key in ("kp", "kd", "force_limit"):
            value = special.get(joint, {}).get(key, entry.get(key))
            if not isinstance(value, int | float) or not value > 0:
                raise FungraspError(
                    f"{path}: actuators.{key} for joint '{joint}' must be a positive number, not {value!r}"
                )
            values[key] = float(value)
        actuators[joint] = Actuator(joint, **values)
    return actuators


def _unit(path: Path, name: str, value: Any) -> np.ndarray:
    vector = np.asarray(value, dtype=float)
    if vector.shape != (3,) or not np.isclose(np.linalg.norm(vector), 1.0, atol=1e-3):
        raise FungraspError(f"{path}: {name} must be a unit vector of 3 numbers, not {value!r}")
    return vector / np.linalg.norm(vector)


def _put_at_origin(spec: mujoco.MjSpec, palm: str) -> None:
    """Move the model so that a static body has the identity pose in the world."""
    # The copy is compiled: a frame added to a compiled spec has no effect.
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    pose = np.concatenate([data.body(palm).xpos, data.body(palm).xquat])
    if np.array_equal(pose, [0, 0, 0, 1, 0, 0, 0]):
        return
    back = invert(pose)
    world = spec.worldbody
    parts = [*world.frames, *world.bodies, *world.geoms, *world.sites, *world.cameras, *world.lights]
    outermost = [part for part in parts if part.frame is None]
    frame = world.add_frame(pos=back[:3], quat=back[3:])
    for part in outermost:
        part.set_frame(frame)
