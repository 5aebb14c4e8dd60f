"""What is measured instead of what is: biased, jittering joints and poses.

The bias of a trial is drawn with its sample; the jitter is drawn at every call.
"""

from __future__ import annotations

import numpy as np
from array_api_compat import array_namespace

from fungrasp.geometry.poses import Array, quaternion_from_rotation_vector, quaternion_multiply, rotate
from fungrasp.transfer.randomization import Randomisation, Sample, Spread


def noisy_joints(
    angles: np.ndarray, sample: Sample, randomisation: Randomisation, rng: np.random.Generator
) -> np.ndarray:
    """Measured finger joints [rad], shape [W, M].

    Args:
        angles: true ones [rad], shape [W, M].
        sample: of these W trials.
        randomisation: whose jitter counts.
        rng: of the jitter.
    """
    return angles + sample.joint_bias + randomisation.joint_noise.jitter * rng.normal(size=angles.shape)


def noisy_wrist(
    pose: np.ndarray, sample: Sample, randomisation: Randomisation, rng: np.random.Generator
) -> np.ndarray:
    """Measured pose of the palm, shape [W, 7]; arguments as for ``noisy_joints``."""
    spreads = randomisation.wrist_position_noise, randomisation.wrist_rotation_noise
    return offset_pose(pose, sample.wrist_bias + _jitter(*spreads, len(pose), rng))


def noisy_object(
    pose: np.ndarray,
    sample: Sample,
    randomisation: Randomisation,
    rng: np.random.Generator,
    center: np.ndarray | None = None,
) -> np.ndarray:
    """Pose of the object as the tracker sees it, shape [W, 7].

    Args:
        pose: true one, shape [W, 7].
        sample: of these W trials.
        randomisation: whose jitter counts.
        rng: of the jitter.
        center: of mass [m], object frame, shape [W, 3]: what the tracked object turns about; its origin if
            None.
    """
    spreads = randomisation.object_position_noise, randomisation.object_rotation_noise
    return offset_pose(pose, sample.object_bias + _jitter(*spreads, len(pose), rng), center)


def offset_pose(pose: Array, offset: Array, center: Array | None = None) -> Array:
    """Poses moved and turned a little.

    Args:
        pose: shape [..., 7].
        offset: of the position [m], world frame, and rotation vector [rad], body frame, shape [..., 6].
        center: stays where it is but for the offset of the position [m], body frame, shape [..., 3]; the
            body's origin if None.

    Returns:
        Shape [..., 7].
    """
    xp = array_namespace(pose, offset)
    position, before = pose[..., :3] + offset[..., :3], pose[..., 3:]
    after = quaternion_multiply(before, quaternion_from_rotation_vector(offset[..., 3:]))
    if center is not None:
        position = position + rotate(before, center) - rotate(after, center)
    return xp.concat([position, after], axis=-1)


def shift_on_table(pose: Array, shift: Array, center: Array | None = None) -> Array:
    """Objects pushed and turned on the table, as ``Sample.object_shift`` says.

    Args:
        pose: world frame, shape [..., 7].
        shift: x and y [m] and a turn about the vertical [rad], shape [..., 3].
        center: of mass [m], object frame, shape [..., 3]: on the axis of the turn; the origin if None.

    Returns:
        Shape [..., 7].
    """
    xp = array_namespace(pose, shift)
    zero = xp.zeros_like(shift[..., :1])
    turn = quaternion_from_rotation_vector(xp.concat([zero, zero, shift[..., 2:]], axis=-1))
    before, after = pose[..., 3:], quaternion_multiply(turn, pose[..., 3:])
    position = pose[..., :3] + xp.concat([shift[..., :2], zero], axis=-1)
    if center is not None:
        position = position + rotate(before, center) - rotate(after, center)
    return xp.concat([position, after], axis=-1)


def _jitter(position: Spread, rotation: Spread, count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(count, 6)) * np.repeat([position.jitter, rotation.jitter], 3)
