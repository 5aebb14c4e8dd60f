"""Inputs of policy networks: phi(s) of the paper (section IV.B.1), and additional mesh features.

Pure functions of measurements and plan, for any array-API library. Positions and directions are in the palm
frame, independent of the table. All features are scaled to the order of one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fungrasp.core.errors import UnknownNameError
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    clip,
    compose,
    invert,
    like,
    relative,
    rotate,
    rotation_matrix,
    rotation_vector,
    side_by_side,
    stack,
)
from fungrasp.task.policy import Privileged

POSITION_UNIT = 0.05
"""Unit of positions [m]."""
FORCE_UNIT = 5.0
"""Unit of forces [N]."""
SERVO_UNIT = 0.2
"""Unit of differences between servo target and joint [rad]."""
INPUT_LIMIT = 10.0
"""Bound of network inputs. During a grasp, features hardly ever reach it: it corresponds to 0.5 m between
hand and object or an object speed of 1 m/s. Without it, a thrown object would be hundreds of standard
deviations away, and one such step can ruin a training run."""
_MOTION_UNITS = np.repeat(
    [[[0.01, 0.05]], [[0.02, 0.1]], [[POSITION_UNIT, 0.3]], [[POSITION_UNIT, 0.3]], [[0.01, 0.1]]], 3, axis=-1
)
"""Units of translation [m] and rotation [rad], shape [5, 1, 6], of five relative poses: palm to its setpoint,
to its previous pose and to its goal; object to its planned pose in the palm and to its previous one."""
_PHASE_BEGINS, _PHASE_ENDS = np.array([-1.0, 0.0, 0.0, 0.0]), np.array([0.0, 2.0, 2.0, 2.0])
"""Limits of the four numbers of ``_phase`` [s]."""


@dataclass(frozen=True, eq=False)
class MeasuredState:
    """The measured state of W hands and their objects."""

    joints: Array
    """Angles of the independent joints [rad], shape [W, U]."""
    joint_setpoints: Array
    """Last setpoints of the joints' servos [rad], shape [W, U]."""
    palm_pose: Array
    """Measured pose of the palm body, world frame, shape [W, 7]."""
    palm_setpoint: Array
    """Last setpoint of the palm, world frame, shape [W, 7]."""
    object_pose: Array
    """Tracked pose of the object, world frame, shape [W, 7]."""
    keypoints: Array
    """Key points of the hand (``Hand.keypoint_names``), palm frame [m], shape [W, K, 3]."""
    surface_distance: Array
    """Signed distance of the key points from the object's surface [m], shape [W, K]."""
    surface_normal: Array
    """Direction away from the surface at the key points, object frame, shape [W, K, 3]."""


@dataclass(frozen=True, eq=False)
class PlanTarget:
    """Targets of the plans in W worlds."""

    palm_goal_world: Array
    """Goal of the palm for the coming control period, world frame, shape [W, 7]."""
    servo_targets: Array
    """Targets of the finger servos for the coming control period [rad], shape [W, U]."""
    palm_in_object: Array
    """Pose of the palm in the planned grasp, object frame, shape [W, 7]."""
    keypoints: Array
    """Key points of the hand in the planned grasp, object frame [m], shape [W, K, 3]."""
    surface_distance: Array
    """Signed distance of those key points from the object's surface [m], shape [W, K]."""
    surface_normal: Array
    """Direction away from the surface there, object frame, shape [W, K, 3]."""
    contacts: Array
    """Links that should touch, shape [W, L] bool."""
    settled_pose: Array
    """Nominal rest pose of the object at planning time, world frame, shape [W, 7]."""
    mass: Array
    """Nominal mass of the object [kg], shape [W]."""
    center: Array
    """Object's center of mass, object frame [m], shape [W, 3]."""
    size: Array
    """Object's extents, object frame [m], shape [W, 3]."""
    since_closing: Array
    """Time since the fingers began to close [s], negative before, shape [W]."""
    since_lift: Array
    """Time since the lift began [s], negative before, shape [W]."""


def robot_features(
    now: MeasuredState, before: MeasuredState, target: PlanTarget, action: Array
) -> dict[str, Array]:
    """Return features from robot sensors by name, each of shape [W, number].

    Args:
        before: state at the previous control step (the same at the first step of an episode).
        action: previous action, shape [W, A].
    """
    xp = array_namespace(now.joints)
    # Similar quantities are stacked: for one robot, the number of array calls dominates the time.
    seen = relative(
        stack(now.palm_pose, now.palm_pose, now.palm_pose, now.palm_pose, before.object_pose),
        stack(now.palm_setpoint, before.palm_pose, target.palm_goal_world, now.object_pose, before.palm_pose),
    )
    object_in_palm, from_object_before = seen[3], seen[4]
    change = compose(stack(target.palm_in_object, from_object_before), object_in_palm)
    poses = xp.concat([seen[:3], change])
    motions = xp.concat([poses[..., :3], rotation_vector(poses[..., 3:])], axis=-1)
    setpoint, palm_before, goal, deviation, change = motions / like(motions, _MOTION_UNITS)
    to_world, from_object = rotation_matrix(stack(now.palm_pose[:, 3:], object_in_palm[:, 3:]))
    # As rows: v_palm = v_world R, with R the palm's rotation, shape [W, 3].
    moved = xp.matmul((now.object_pose - target.settled_pose)[:, None, :3], to_world)[:, 0]
    extents = xp.matmul(xp.abs(from_object), target.size[..., None])[..., 0]
    count, number = now.surface_distance.shape
    vectors = [target.keypoints, target.center[:, None], now.surface_normal, target.surface_normal]
    vectors = xp.matmul(xp.concat(vectors, axis=1), from_object.mT)
    points = vectors[:, : number + 1] + object_in_palm[:, None, :3]
    errors = (points[:, :number] - now.keypoints) / POSITION_UNIT
    normals = vectors[:, number + 1 :].reshape((count, 6 * number))
    distances = xp.concat([now.surface_distance, target.surface_distance], axis=-1)
    distances = clip(distances / 0.02, -1.0, 5.0)
    return {
        "joints": now.joints,
        "joint_errors": (target.servo_targets - now.joints) / SERVO_UNIT,
        "servo_errors": (now.joint_setpoints - now.joints) / SERVO_UNIT,
        "joint_changes": (now.joints - before.joints) / SERVO_UNIT,
        "palm_error": setpoint,
        "palm_change": palm_before,
        "palm_goal": goal,
        "up": to_world[:, 2],
        "palm_height": now.palm_pose[:, 2:3] / (2 * POSITION_UNIT),
        "object_center": points[:, number] / (2 * POSITION_UNIT),
        "object_extents": extents / (2 * POSITION_UNIT),
        "object_deviation": deviation,
        "object_moved": moved / POSITION_UNIT,
        "object_change": change,
        "keypoint_errors": errors.reshape((count, 3 * number)),
        "surface_distances": distances[:, :number],
        "surface_normals": normals[:, : 3 * number],
        "target_distances": distances[:, number:],
        "target_normals": normals[:, 3 * number :],
        "target_contacts": xp.astype(target.contacts, now.joints.dtype),
        "mass": xp.log(target.mass[:, None] / 0.3),
        "phase": _phase(target.since_closing, target.since_lift),
        "last_action": action,
    }


def contact_features(contacts: Array, forces: Array, targets: Array) -> dict[str, Array]:
    """Return contact features by name (f and g_c of the paper), known to teachers and inferred by students.

    Args:
        contacts: contact of each link, in [0, 1], shape [W, L].
        forces: contact forces [N], shape [W, L].
        targets: links that should touch, shape [W, L] bool.
    """
    xp = array_namespace(forces)
    asked = xp.astype(targets, forces.dtype)
    touching = xp.astype(contacts, forces.dtype)
    return {
        "contacts": touching,
        "contact_errors": asked - touching,
        "contact_forces": scaled_forces(forces),
    }


def scaled_forces(forces: Array) -> Array:
    """Scale forces [N] for policies: ``tanh(f / 5 N)``."""
    return array_namespace(forces).tanh(forces / FORCE_UNIT)


def unscaled_forces(scaled: np.ndarray) -> np.ndarray:
    """Invert ``scaled_forces``. The result [N] is at most ``3 FORCE_UNIT``, because scaled forces
    saturate."""
    return FORCE_UNIT * np.arctanh(np.clip(scaled, 0.0, np.tanh(3.0)))


def value_features(privileged: Privileged, palm_pose: Array) -> dict[str, Array]:
    """Return the additional inputs of PPO's value network, by name.

    Args:
        palm_pose: measured palm pose, world frame, shape [W, 7].
    """
    p, xp = privileged, array_namespace(palm_pose)
    back = invert(palm_pose)[:, 3:]
    return {
        "object_velocity": rotate(back, p.object_velocity[:, :3]) / 0.2,
        "object_spin": rotate(back, p.object_velocity[:, 3:]) / 2.0,
        "table_forces": scaled_forces(p.table_forces),
        "self_force": scaled_forces(p.self_force)[:, None],
        "object_on_table": xp.astype(p.object_on_table, palm_pose.dtype)[:, None],
        "friction": p.friction[:, None],
        "true_mass": xp.log(p.object_mass[:, None] / 0.3),
    }


def flatten(parts: Mapping[str, Array]) -> Array:
    """Concatenate features, shape [W, sum of numbers]."""
    values = list(parts.values())
    return array_namespace(values[0]).concat(values, axis=-1)


def network_input(parts: Mapping[str, Array]) -> Array:
    """Return concatenated and ``limited`` features for policy and value networks, shape [W, sum of
    numbers]."""
    return limited(flatten(parts))


def limited(values: Array) -> Array:
    """Clip values to ``INPUT_LIMIT``, in single precision. NaN, as in finished worlds, is kept."""
    xp = array_namespace(values)
    return xp.astype(clip(values, -INPUT_LIMIT, INPUT_LIMIT), xp.float32)


def layout(parts: Mapping[str, Array]) -> tuple[tuple[str, int], ...]:
    """Return name and size of each feature, in order."""
    return tuple((name, int(value.shape[-1])) for name, value in parts.items())


def _phase(since_closing: Array, since_lift: Array) -> Array:
    """Return the phase of the episode, shape [W, 4]: time before closing and after it [s], whether the lift
    has begun, time of the lift [s]."""
    times = side_by_side(since_closing, since_closing, since_lift, since_lift)
    phase = clip(times, like(times, _PHASE_BEGINS), like(times, _PHASE_ENDS))
    phase[:, 2] = since_lift >= 0
    return phase


LayoutName = Literal["full", "paper"]
"""Name of an observation layout."""


@dataclass(frozen=True)
class ObservationLayout:
    """Feature names, in order."""

    network: tuple[str, ...]
    """Inputs of policy and value network."""
    encoder: tuple[str, ...]
    """Inputs of a student's encoder for each past control step."""


LAYOUTS: Mapping[LayoutName, ObservationLayout] = {
    "full": ObservationLayout(
        (
            "joints",
            "joint_errors",
            "servo_errors",
            "joint_changes",
            "palm_error",
            "palm_change",
            "palm_goal",
            "up",
            "palm_height",
            "object_center",
            "object_extents",
            "object_deviation",
            "object_moved",
            "object_change",
            "keypoint_errors",
            "surface_distances",
            "surface_normals",
            "target_distances",
            "target_normals",
            "target_contacts",
            "mass",
            "phase",
            "last_action",
        ),
        (
            "joints",
            "servo_errors",
            "joint_changes",
            "palm_error",
            "target_contacts",
            "last_action",
            "surface_distances",
        ),
    ),
    # Section IV.B.1, in its order: q_r; orientation of the wrist relative to the table, and its velocity;
    # position of the object and its deviation from the grasp (T_o, g_r), its velocity, its displacement;
    # height of the wrist; g_p; target contacts of g_c. Forces and contact errors of g_c are privileged.
    # Distances to the mesh and to servo setpoints are left out, because they reveal contacts. Section IV.C.1:
    # the encoder gets joints, the difference of the wrist from its target, target contacts and actions.
    "paper": ObservationLayout(
        (
            "joints",
            "up",
            "palm_change",
            "object_center",
            "object_deviation",
            "object_change",
            "object_moved",
            "palm_height",
            "keypoint_errors",
            "target_contacts",
        ),
        ("joints", "palm_goal", "target_contacts", "last_action"),
    ),
}


def check_layout(name: str) -> None:
    """Check the name of a layout.

    Raises:
        UnknownNameError: unknown layout.
    """
    if name not in LAYOUTS:
        raise UnknownNameError("observation layout", name, LAYOUTS)


def network_parts(features: Mapping[str, Array], name: LayoutName, encoder: bool) -> dict[str, Array]:
    """Select policy inputs from robot features.

    Args:
        features: result of ``robot_features``.
        encoder: whether the policy is a student with an encoder, whose additional inputs come last.
    """
    one = LAYOUTS[name]
    names = (*one.network, *(one.encoder if encoder else ()))
    return {part: features[part] for part in dict.fromkeys(names)}


def encoder_parts(features: Mapping[str, Array], name: LayoutName) -> dict[str, Array]:
    """Select the inputs of a student's encoder for one control step. Arguments: see ``network_parts``."""
    return {part: features[part] for part in LAYOUTS[name].encoder}
