"""Physical parameters of worlds as changes of MuJoCo model fields, shared by all engines.

The changes are the same on every device; each engine writes them to its own arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple, TypedDict

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.simulation.scene import HAND_PREFIX, Scene

INERTIAL = (
    "body_mass",
    "body_subtreemass",
    "body_ipos",
    "body_iquat",
    "body_inertia",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
)
"""Model fields that depend on the object's mass and center of mass."""

_SAMEFRAME_NONE = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


class Parameters(TypedDict, total=False):
    """Physical parameters of I worlds for ``Engine.set_parameters``."""

    object_mass: np.ndarray | None
    """Mass of the object [kg], shape [I]. Its inertia scales with it; its center of mass is the scene's
    unless given."""
    object_center: np.ndarray | None
    """Center of mass [m], object frame, shape [I, 3]; requires ``object_mass`` and ``object_inertia``."""
    object_inertia: np.ndarray | None
    """Inertia about the center of mass, axes of the object frame [kg m2], shape [I, 3, 3]."""
    friction: np.ndarray | None
    """Sliding friction of hand, object and table, shape [I]."""
    table_height: np.ndarray | None
    """Height of the table top at the world's origin [m], shape [I]."""
    table_tilt: np.ndarray | None
    """Rotation vector of the table top, world frame x and y [rad], shape [I, 2]."""
    joint_friction: np.ndarray | None
    """Dry friction of each joint of the hand in addition to the scene's [N m], shape [I, M]."""
    joint_damping: np.ndarray | None
    """Factor on the scene's damping of each joint, shape [I, M]."""
    servo_stiffness: np.ndarray | None
    """Factor on the scene's stiffness of each finger servo, shape [I, U]."""
    servo_damping: np.ndarray | None
    """Factor on the scene's damping of each finger servo, shape [I, U]."""
    wrist_stiffness: np.ndarray | None
    """Factor on stiffness and damping of the wrist's servos, shape [I]."""


class FieldChange(NamedTuple):
    """New values of a model field in some worlds."""

    field: str
    """Name of the field in MuJoCo's model."""
    index: tuple[np.ndarray | int | slice, ...]
    """Broadcasting indices into the field, worlds first."""
    values: np.ndarray | float
    """New values."""


class WorldParameters:
    """Converts parameters to changes of a scene's model. It keeps no state of the worlds."""

    def __init__(self, scene: Scene):
        model, hand = scene.model, scene.hand
        self._scene, self._model = scene, model
        self._object = model.body("object").id
        self._table = model.geom("table").id
        self._object_geoms = np.flatnonzero(model.geom_bodyid == self._object)
        self._object_dofs = int(model.joint("object").dofadr[0]) + np.arange(6)
        names = [HAND_PREFIX + name for name in hand.joint_names]
        self._finger_dofs = np.array([model.joint(name).dofadr[0] for name in names])

    def changes(
        self, ids: np.ndarray, held: np.ndarray, parameters: Parameters, anew: bool = False
    ) -> Iterator[FieldChange]:
        """Yield field changes, in the order in which they must be written.

        Args:
            ids: worlds, shape [I].
            held: object index of each of these worlds, shape [I].
            parameters: as for ``Engine.set_parameters``; None leaves a parameter unchanged.
            anew: whether the worlds receive these objects now.

        Raises:
            FungraspError: a center of mass is given without mass and inertia.
        """
        given = {name: np.asarray(v, dtype=float) for name, v in parameters.items() if v is not None}
        if anew:
            for name, table in self._scene.fields.items():
                yield FieldChange(name, (ids,), table[held])
            given.setdefault("object_mass", self._nominal("body_mass", held)[:, self._object])
            given.setdefault("table_height", np.zeros(len(ids)))
        if "object_mass" in given:
            yield from self._mass(ids, held, given["object_mass"])
        if "object_center" in given:
            if not {"object_mass", "object_inertia"} <= set(given):
                raise FungraspError("a center of mass is given together with mass and inertia")
            yield from self._center(ids, given)
        if "friction" in given:
            yield FieldChange("geom_friction", (ids, slice(None), 0), given["friction"][:, None])
        yield from self._joints_and_servos(ids[:, None], given)
        yield from self._table_top(ids, given)

    def _mass(self, ids: np.ndarray, held: np.ndarray, mass: np.ndarray) -> Iterator[FieldChange]:
        """Scale inertial fields with the mass, and derived fields too, because the body floats freely."""
        body, dofs = self._object, self._object_dofs
        nominal = {name: self._nominal(name, held) for name in INERTIAL}
        own = nominal["body_mass"][:, body].copy()
        ratio = (mass / own)[:, None]
        nominal["body_subtreemass"][:, 0] += mass - own
        for name in ("body_mass", "body_subtreemass", "body_inertia"):
            nominal[name][:, body] *= ratio.reshape(-1, *(1,) * (nominal[name].ndim - 2))
        nominal["body_invweight0"][:, body] /= ratio
        nominal["dof_invweight0"][:, dofs] /= ratio
        nominal["dof_M0"][:, dofs] *= ratio
        for name, values in nominal.items():
            yield FieldChange(name, (ids,), values)

    def _center(self, ids: np.ndarray, given: Mapping[str, np.ndarray]) -> Iterator[FieldChange]:
        """Set the object's center of mass and its inertia about it."""
        fields = floating_body_fields(given["object_mass"], given["object_center"], given["object_inertia"])
        body, joint = fields
        for name, values in body.items():
            yield FieldChange(name, (ids, self._object), values)
        for name, values in joint.items():
            yield FieldChange(name, (ids[:, None], self._object_dofs), values)
        # MuJoCo ignores the inertial frame if the compiler found it aligned with the body, and rotates geoms
        # with it that the compiler found aligned with it.
        yield FieldChange("body_sameframe", (ids, self._object), _SAMEFRAME_NONE)
        yield FieldChange("geom_sameframe", (ids[:, None], self._object_geoms), _SAMEFRAME_NONE)

    def _joints_and_servos(self, rows: np.ndarray, given: Mapping[str, np.ndarray]) -> Iterator[FieldChange]:
        """Set fields of finger joints and of all servos. rows: worlds, shape [I, 1]."""
        model, dofs = self._model, self._finger_dofs
        if "joint_friction" in given:
            total = model.dof_frictionloss[dofs] + given["joint_friction"]
            yield FieldChange("dof_frictionloss", (rows, dofs), total)
        if "joint_damping" in given:
            yield self._scaled("dof_damping", rows, (dofs,), given["joint_damping"])
        # The force of a position servo is gain[0] * ctrl + bias[1] * angle + bias[2] * velocity.
        fingers, wrist = self._scene.finger_actuators, self._scene.wrist_actuators
        stiffness = (("actuator_gainprm", 0), ("actuator_biasprm", 1))
        damping = (("actuator_biasprm", 2),)
        for name, servos, numbers in (
            ("servo_stiffness", fingers, stiffness),
            ("servo_damping", fingers, damping),
            ("wrist_stiffness", wrist, stiffness + damping),
        ):
            if name in given:
                factor = given[name].reshape(len(rows), -1)
                for field, column in numbers:
                    yield self._scaled(field, rows, (servos, column), factor)

    def _table_top(self, ids: np.ndarray, given: Mapping[str, np.ndarray]) -> Iterator[FieldChange]:
        table = self._table
        if "table_height" in given:
            top = self._model.geom_pos[table, 2] + given["table_height"]
            yield FieldChange("geom_pos", (ids, table, 2), top)
        if "table_tilt" in given:
            turn = np.concatenate([given["table_tilt"], np.zeros((len(ids), 1))], axis=1)
            yield FieldChange("geom_quat", (ids, table), quaternion_from_rotation_vector(turn))
        if {"table_height", "table_tilt"} & set(given):
            # MuJoCo ignores the pose of a geom that the compiler found at its body's origin.
            yield FieldChange("geom_sameframe", (ids, table), _SAMEFRAME_NONE)

    def _scaled(
        self,
        name: str,
        rows: np.ndarray,
        index: tuple[np.ndarray] | tuple[np.ndarray, int],
        factor: np.ndarray,
    ) -> FieldChange:
        """Multiply the scene's values of a field by factors, shape [I, ...]."""
        return FieldChange(name, (rows, *index), getattr(self._model, name)[index] * factor)

    def _nominal(self, name: str, held: np.ndarray) -> np.ndarray:
        """Return the scene's values of a model field, one row for each object index in ``held``."""
        table = self._scene.fields.get(name)
        if table is not None:
            return table[held].copy()
        value = getattr(self._model, name)
        return np.broadcast_to(value, (len(held), *value.shape)).copy()


def floating_body_fields(
    mass: np.ndarray, center: np.ndarray, inertia: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the fields of I bodies with a free joint, as MuJoCo's compiler derives them.

    A free joint translates the body's origin along the world axes and rotates the body about its own axes. In
    these coordinates ``M^-1`` has the blocks ``1/m - c^ J^-1 c^`` (linear) and ``J^-1`` (angular), with
    ``c^`` the cross product matrix of the center of mass. MuJoCo's inverse weights are the means of their
    diagonals.

    Args:
        mass: [kg], shape [I].
        center: center of mass [m], body frame, shape [I, 3].
        inertia: about the center of mass, axes of the body frame [kg m2], shape [I, 3, 3].

    Returns:
        fields of the body by name, one row each; fields of its six degrees of freedom, shape [I, 6].
    """
    # The axes of eigh form a rotation only if their determinant is positive.
    moments, axes = np.linalg.eigh(inertia)
    axes[..., 0] *= np.sign(np.linalg.det(axes))[:, None]
    turns = np.zeros((len(mass), 4))
    for turn, matrix in zip(turns, axes, strict=True):
        mujoco.mju_mat2Quat(turn, matrix.ravel())
    x, y, z = center.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    lightness = np.linalg.inv(inertia)
    linear = 1.0 / mass - np.trace(cross @ lightness @ cross, axis1=1, axis2=2) / 3
    angular = np.trace(lightness, axis1=1, axis2=2) / 3
    about_origin = inertia - mass[:, None, None] * (cross @ cross)
    diagonal = np.diagonal(about_origin, axis1=1, axis2=2)
    body = {
        "body_mass": mass,
        "body_ipos": center,
        "body_iquat": turns,
        "body_inertia": moments,
        "body_invweight0": np.stack([1.0 / mass, angular], axis=1),
    }
    joint = {
        "dof_invweight0": np.repeat(np.stack([linear, angular], axis=1), 3, axis=1),
        "dof_M0": np.concatenate([np.repeat(mass[:, None], 3, axis=1), diagonal], axis=1),
    }
    return body, joint
