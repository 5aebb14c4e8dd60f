"""Random parameters of episodes, and poses with offsets."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from array_api_compat import array_namespace

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import Array, quaternion_from_rotation_vector, quaternion_multiply, rotate
from fungrasp.sim2real.randomization import MeasurementError, Randomization, Range


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeSample(BatchRecord):
    """Random parameters of W episodes, for a hand with M joints and P pushes."""

    joint_damping: np.ndarray
    """Factor on the damping of each joint, shape [W, M]."""
    servo_stiffness: np.ndarray
    """Factor on the stiffness of each joint's servo, shape [W, M]."""
    servo_damping: np.ndarray
    """Factor on the damping of each joint's servo, shape [W, M]."""
    wrist_stiffness: np.ndarray
    """Factor on stiffness and damping of the wrist's servos, shape [W]."""
    joint_friction: np.ndarray
    """Dry friction of each joint as a fraction of its servo's torque limit, shape [W, M]."""
    encoder_bias: np.ndarray
    """Encoder error of each joint [rad], shape [W, M]."""
    backlash: np.ndarray
    """Backlash of each joint, in either direction [rad], shape [W, M]."""
    wrist_offset: np.ndarray
    """Calibration error of the palm: offset [m], world frame, and rotation vector [rad], palm frame, shape
    [W, 6]."""
    wrist_lag: np.ndarray
    """Time constant of the wrist's lag [s], shape [W]."""
    mass: np.ndarray
    """Factor on the mass of the object, shape [W]."""
    center_of_mass_shift: np.ndarray
    """Displacement of the center of mass along the axes of the object's frame, as a fraction of its extents,
    shape [W, 3]."""
    object_scale: np.ndarray
    """Factor on the size of the object, shape [W]."""
    table_height: np.ndarray
    """Height of the table top above the nominal one [m], shape [W]."""
    table_tilt: np.ndarray
    """Rotation vector of the table top, world frame x and y [rad], shape [W, 2]."""
    joint_bias: np.ndarray
    """Error of the measured joints [rad], shape [W, M]."""
    palm_bias: np.ndarray
    """Error of the measured palm pose: offset [m], world frame, and rotation vector [rad], shape [W, 6]."""
    object_bias: np.ndarray
    """Error of the object's estimated and tracked pose: offset [m], world frame, and rotation vector [rad],
    shape [W, 6]."""
    tracker_delay: np.ndarray
    """Age of the tracked object pose [s], shape [W]."""
    tracker_freezes: np.ndarray
    """Whether the tracker loses the object near the hand, shape [W] bool."""
    action_delay: np.ndarray
    """Delay from an action to the servos [s], shape [W]."""
    push_direction: np.ndarray
    """Directions of the pushes, unit vectors, world frame, shape [W, P, 3]."""
    push_force: np.ndarray
    """Force of each push [N], shape [W, P]."""
    push_weights: np.ndarray
    """Additional force of each push in multiples of the object's true weight, shape [W, P]."""
    push_start: np.ndarray
    """Time of each push from the start of the phase [s], shape [W, P]."""
    object_shift: np.ndarray
    """Displacement of the object on the table after planning: x and y [m], and rotation about the vertical
    [rad], shape [W, 3]."""
    friction: np.ndarray | None = None
    """Sliding friction of hand, object and table, shape [W]; the nominal one if None."""


def draw(randomization: Randomization, count: int, joints: int, rng: np.random.Generator) -> EpisodeSample:
    """Draw the parameters of W episodes.

    Args:
        count: number of episodes W.
        joints: number of the hand's joints M, including coupled joints.
        rng: the same state gives the same sample.
    """
    r, pushes = randomization, len(randomization.push_times)

    def factor(bounds: Range, *shape: int) -> np.ndarray:
        return np.exp(rng.uniform(*np.log(bounds), size=(count, *shape)))

    def bias(position: MeasurementError, rotation: MeasurementError) -> np.ndarray:
        errors = (position, rotation)
        normal = rng.normal(size=(count, 6)) * np.repeat([e.bias for e in errors], 3)
        if any(e.offset or e.offset_deviation for e in errors):
            unit = _unit(rng.normal(size=(count, 2, 3)))
            length = np.array([[e.offset] for e in errors], dtype=float)
            if any(e.offset_deviation for e in errors):
                length = length + rng.normal(size=(count, 2, 1)) * [[e.offset_deviation] for e in errors]
            normal += (unit * length).reshape(count, 6)
        if any(e.uniform for e in errors):
            normal += rng.uniform(-1, 1, (count, 6)) * np.repeat([e.uniform for e in errors], 3)
        return normal

    direction = _unit(rng.normal(size=(count, pushes, 3)))
    around = rng.uniform(0.0, 2 * np.pi, count)
    # Uniform over the area of a ring: the squared radius is uniform.
    low, high = r.object_shift
    inner = (low / high) ** 2 if high else 0.0
    distance = high * np.sqrt(inner + (1.0 - inner) * rng.uniform(size=count))
    turn = rng.uniform(-r.object_turn, r.object_turn, count)
    starts = np.array(r.push_times, dtype=float).reshape(pushes, 2)
    sample = {
        "joint_damping": factor(r.joint_damping, joints),
        "servo_stiffness": factor(r.servo_stiffness, joints),
        "servo_damping": factor(r.servo_damping, joints),
        "wrist_stiffness": factor(r.wrist_stiffness),
        "mass": factor(r.mass),
        "friction": None if r.friction is None else rng.uniform(*r.friction, size=count),
        "table_height": rng.uniform(*r.table_height, size=count),
        "joint_bias": rng.normal(size=(count, joints)) * r.joint_error.bias,
        "palm_bias": bias(r.palm_position_error, r.palm_rotation_error),
        "object_bias": bias(r.object_position_error, r.object_rotation_error),
        "tracker_delay": rng.uniform(*r.tracker_delay, size=count),
        "action_delay": rng.uniform(*r.action_delay, size=count),
        "push_direction": direction,
        "push_force": rng.uniform(*r.push_force, size=(count, pushes)),
        "push_start": rng.uniform(*starts.T, size=(count, pushes)),
        "push_weights": rng.uniform(*r.push_weights, size=(count, pushes)),
    }
    # Parameters that were added later are drawn last, so that earlier results are unchanged.
    offset = bias(
        MeasurementError(offset=r.wrist_position_offset), MeasurementError(offset=r.wrist_rotation_offset)
    )
    downhill = rng.uniform(0.0, 2 * np.pi, count)
    slope = rng.uniform(*r.table_tilt, size=count)
    moved = rng.uniform(size=count) < r.shift_probability
    return EpisodeSample(
        **sample,
        joint_friction=rng.uniform(*r.joint_friction, size=(count, joints)),
        encoder_bias=rng.uniform(-r.encoder_bias, r.encoder_bias, (count, joints)),
        backlash=rng.uniform(*r.backlash, size=(count, joints)),
        wrist_offset=offset,
        wrist_lag=rng.uniform(*r.wrist_lag, size=count),
        center_of_mass_shift=r.center_of_mass_shift * rng.uniform(-1, 1, (count, 3)),
        object_scale=rng.choice(r.object_scales, count),
        table_tilt=slope[:, None] * np.stack([np.cos(downhill), np.sin(downhill)], axis=1),
        tracker_freezes=rng.uniform(size=count) < r.tracker_freeze,
        object_shift=np.where(
            moved[:, None],
            np.stack([distance * np.cos(around), distance * np.sin(around), turn], axis=1),
            0.0,
        ),
    )


def random_stream(purpose: str, *numbers: int) -> np.random.Generator:
    """Return an independent random generator for a purpose and numbers (seed, episode, ...)."""
    return np.random.default_rng([zlib.crc32(purpose.encode()), *numbers])


def draw_each(
    randomization: Randomization, seed: int, numbers: Sequence[int] | np.ndarray, joints: int
) -> EpisodeSample:
    """Draw the parameters of episodes by their numbers, independent of other episodes.

    Args:
        numbers: episode numbers, length W.
        joints: number of the hand's joints M.
    """
    generators = [random_stream("episode", seed, int(number)) for number in numbers]
    return EpisodeSample.join([draw(randomization, 1, joints, rng) for rng in generators])


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def offset_pose(pose: Array, offset: Array, center: Array | None = None) -> Array:
    """Offset poses.

    Args:
        pose: shape [..., 7].
        offset: position offset [m], world frame, and rotation vector [rad], body frame, shape [..., 6].
        center: center of the rotation [m], body frame, shape [..., 3]; the body's origin if None.

    Returns:
        shape [..., 7].
    """
    xp = array_namespace(pose, offset)
    position, before = pose[..., :3] + offset[..., :3], pose[..., 3:]
    after = quaternion_multiply(before, quaternion_from_rotation_vector(offset[..., 3:]))
    if center is not None:
        position = position + rotate(before, center) - rotate(after, center)
    return xp.concat([position, after], axis=-1)


def shift_on_table(pose: Array, shift: Array, center: Array | None = None) -> Array:
    """Move and rotate objects on the table (``EpisodeSample.object_shift``).

    Args:
        pose: world frame, shape [..., 7].
        shift: x and y [m] and rotation about the vertical [rad], shape [..., 3].
        center: center of mass, on the rotation axis [m], object frame, shape [..., 3]; the origin if None.

    Returns:
        shape [..., 7].
    """
    xp = array_namespace(pose, shift)
    zero = xp.zeros_like(shift[..., :1])
    turn = quaternion_from_rotation_vector(xp.concat([zero, zero, shift[..., 2:]], axis=-1))
    before, after = pose[..., 3:], quaternion_multiply(turn, pose[..., 3:])
    position = pose[..., :3] + xp.concat([shift[..., :2], zero], axis=-1)
    if center is not None:
        position = position + rotate(before, center) - rotate(after, center)
    return xp.concat([position, after], axis=-1)


def tilt_on_table(pose: Array, tilt: Array, height: Array) -> Array:
    """Tilt objects with the table about the point of the table top below their origin.

    Args:
        pose: world frame, shape [..., 7].
        tilt: rotation vector of the table, world frame x and y [rad], shape [..., 2].
        height: height of the table top below the object [m], shape [...].

    Returns:
        shape [..., 7].
    """
    xp = array_namespace(pose, tilt)
    zero = xp.zeros_like(pose[..., :1])
    turn = quaternion_from_rotation_vector(xp.concat([tilt, zero], axis=-1))
    up = xp.concat([zero, zero, pose[..., 2:3] - height[..., None]], axis=-1)
    position = pose[..., :3] - up + rotate(turn, up)
    return xp.concat([position, quaternion_multiply(turn, pose[..., 3:])], axis=-1)
