"""Identified joint dynamics of a particular hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_toml
from fungrasp.hands import Hand, as_hand

QUANTITIES = ("stiffness", "damping", "friction", "armature")
TORQUE_LIMIT = "torque_limit"
"""Quantity of a file that identification does not estimate; its author sets it."""


@dataclass(frozen=True, eq=False)
class JointDynamics:
    """Second-order joints with Coulomb friction, position servos and a common delay:

    (inertia + armature) a = stiffness (u(t - delay) - q) - damping v - friction sign(v) - weight
    """

    joints: tuple[str, ...]
    """Names of independent joints of a hand, length J."""
    stiffness: np.ndarray
    """Stiffness of the servos [N m/rad], shape [J]."""
    damping: np.ndarray
    """Total damping of joint and servo [N m s/rad], shape [J]."""
    friction: np.ndarray
    """Dry friction [N m], shape [J]."""
    armature: np.ndarray
    """Inertia of the drives, reflected to the joints [kg m^2], shape [J]."""
    delay: float
    """Delay from a command to its first effect [s]."""
    torque_limit: np.ndarray | None = None
    """Torque limits of the servos [N m], shape [J]; the model's if None."""

    def __post_init__(self) -> None:
        for name in (*QUANTITIES, TORQUE_LIMIT):
            values = getattr(self, name)
            if values is None:
                continue
            if np.shape(values) != (len(self.joints),):
                raise FungraspError(
                    f"{name} of joint dynamics has shape {np.shape(values)}, not one per joint"
                )
            if not np.isfinite(values).all() or np.min(values, initial=0.0) < 0:
                raise FungraspError(f"{name} of joint dynamics must be finite and not negative")
        if not 0 <= self.delay <= 1:
            raise FungraspError(f"the delay of joint dynamics is 0 to 1 s, not {self.delay}")


def model_dynamics(hand: Hand) -> JointDynamics:
    """Return the dynamics of the hand's model, without delay."""
    model = hand.model
    rows = [model.joint(name).dofadr[0] for name in hand.actuators]
    servos = hand.actuators.values()
    return JointDynamics(
        tuple(hand.actuators),
        np.array([servo.kp for servo in servos]),
        np.array([servo.kd for servo in servos]) + model.dof_damping[rows],
        model.dof_frictionloss[rows].copy(),
        model.dof_armature[rows].copy(),
        0.0,
    )


@dataclass(frozen=True, eq=False)
class HandDynamics:
    """Identified dynamics of a hand, as factors on the model's."""

    damping: np.ndarray
    """Factor on the damping of each joint and its servo, shape [M]; only their sum is identified."""
    servo_stiffness: np.ndarray
    """Factor on the stiffness of each joint's servo, shape [M]."""

    @classmethod
    def of(cls, hand: Hand, dynamics: JointDynamics) -> HandDynamics:
        """Return the factors for identified independent joints; the factors of other joints are 1."""
        model, factors = model_dynamics(hand), np.ones((2, len(hand.joint_names)))
        for j, name in enumerate(dynamics.joints):
            joint, row = hand.joint_names.index(name), model.joints.index(name)
            factors[0, joint] = dynamics.stiffness[j] / model.stiffness[row]
            factors[1, joint] = dynamics.damping[j] / max(model.damping[row], 1e-9)
        return cls(factors[1], factors[0])

    def stiffness(self, hand: Hand) -> np.ndarray:
        """Return the stiffness of the servos [N m/rad], shape [U]."""
        driven = [hand.joint_names.index(name) for name in hand.actuators]
        return np.array([servo.kp for servo in hand.actuators.values()]) * self.servo_stiffness[driven]


def set_dynamics(model: mujoco.MjModel, dynamics: JointDynamics) -> None:
    """Set the dynamics of a compiled hand or of a scene with one, in place, by joint and servo names.

    All damping is set on the joint and none on the servo. A model has no delay.
    """
    for j, name in enumerate(dynamics.joints):
        dof = model.joint(name).dofadr[0]
        model.dof_damping[dof] = dynamics.damping[j]
        model.dof_frictionloss[dof] = dynamics.friction[j]
        model.dof_armature[dof] = dynamics.armature[j]
        servo = model.actuator(name).id
        model.actuator_gainprm[servo, 0] = dynamics.stiffness[j]
        model.actuator_biasprm[servo, 1] = -dynamics.stiffness[j]
        model.actuator_biasprm[servo, 2] = 0.0
        if dynamics.torque_limit is not None:
            model.actuator_forcerange[servo] = np.array([-1.0, 1.0]) * dynamics.torque_limit[j]


def identified_hand(hand: Hand | str, path: str | Path | None) -> Hand:
    """Return a hand with identified dynamics, for planning and training.

    A servo's damping scales with its stiffness, because its torque constant scales both; the remaining
    damping is the joint's. A hand has no delay.

    Args:
        hand: a hand, its name, or the path of its TOML file.
        path: file of ``save_dynamics``; the hand is unchanged if None.

    Raises:
        FungraspError: the file can't be read, or has unknown joints, unknown quantities or invalid values.
    """
    hand = as_hand(hand)
    if path is None:
        return hand
    dynamics = load_dynamics(path, hand)
    servos = {}
    for j, name in enumerate(dynamics.joints):
        servo, stiffness = hand.actuators[name], float(dynamics.stiffness[j])
        if not stiffness > 0:
            raise FungraspError(f"{path}: the stiffness of '{name}' must be positive, not {stiffness:g}")
        damping = float(dynamics.damping[j])
        own = min(servo.kd * stiffness / servo.kp, damping)
        torque = servo.force_limit if dynamics.torque_limit is None else float(dynamics.torque_limit[j])
        if not torque > 0:
            raise FungraspError(f"{path}: the torque limit of '{name}' must be positive, not {torque:g}")
        servos[name] = replace(
            servo,
            force_limit=torque,
            kp=stiffness,
            kd=own,
            joint_damping=damping - own,
            joint_friction=float(dynamics.friction[j]),
            joint_armature=float(dynamics.armature[j]),
        )
    return replace(hand, actuators=servos, dynamics_path=Path(path))


def save_dynamics(
    path: str | Path, dynamics: JointDynamics, notes: Mapping[str, Sequence[str]] | None = None
) -> None:
    """Write dynamics as TOML.

    Args:
        notes: for each quantity, a comment for the value of each joint, length J.
    """
    lines = [f"delay = {dynamics.delay:.6g} # s", ""]
    for j, name in enumerate(dynamics.joints):
        lines.append(f'[joints."{name}"]')
        for quantity in QUANTITIES:
            note = f" # {notes[quantity][j]}" if notes and quantity in notes else ""
            lines.append(f"{quantity} = {getattr(dynamics, quantity)[j]:.6g}{note}")
        if dynamics.torque_limit is not None:
            lines.append(f"{TORQUE_LIMIT} = {dynamics.torque_limit[j]:.6g} # N m")
        lines.append("")
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines))


def load_dynamics(path: str | Path, hand: Hand) -> JointDynamics:
    """Read a file of ``save_dynamics``. Missing joints keep the model's values.

    Raises:
        FungraspError: the file can't be read, or has unknown joints or quantities.
    """
    data, model = read_toml(Path(path), "hand dynamics"), model_dynamics(hand)
    values = {quantity: getattr(model, quantity).copy() for quantity in QUANTITIES}
    limits = np.array([servo.force_limit for servo in hand.actuators.values()])
    known, limited = (*QUANTITIES, TORQUE_LIMIT), False
    for key in data:
        if key not in ("delay", "joints"):
            raise FungraspError(f"{path}: unknown field '{key}'; known: delay, joints")
    joints = data.get("joints", {})
    if not isinstance(joints, dict):
        raise FungraspError(f"{path}: 'joints' is a table of tables, [joints.NAME]")
    for name, entries in joints.items():
        if name not in model.joints or not isinstance(entries, dict):
            raise FungraspError(f"{path}: hand '{hand.name}' has no joint '{name}' that is driven")
        for quantity, value in entries.items():
            if quantity not in known or isinstance(value, bool) or not isinstance(value, (int, float)):
                raise FungraspError(
                    f"{path}: {name} takes numbers {', '.join(known)}, not {quantity} = {value!r}"
                )
            limited |= quantity == TORQUE_LIMIT
            chosen = limits if quantity == TORQUE_LIMIT else values[quantity]
            chosen[model.joints.index(name)] = value
    delay = data.get("delay", 0.0)
    if isinstance(delay, bool) or not isinstance(delay, (int, float)):
        raise FungraspError(f"{path}: delay is a number of seconds, not {delay!r}")
    try:
        return JointDynamics(
            model.joints, **values, delay=float(delay), torque_limit=limits if limited else None
        )
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error
