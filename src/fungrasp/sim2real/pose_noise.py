"""Poses that are off: measured with an error, or of objects that were moved on the table."""

from __future__ import annotations

from array_api_compat import array_namespace

from fungrasp.geometry.poses import Array, quaternion_from_rotation_vector, quaternion_multiply, rotate


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
    """Objects moved and turned on the table, as ``EpisodeSample.object_shift`` says.

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


def tilt_on_table(pose: Array, tilt: Array, height: Array) -> Array:
    """Objects whose table tilts about the point of its top that is below their origin.

    Args:
        pose: world frame, shape [..., 7].
        tilt: rotation vector of the table, world frame x and y [rad], shape [..., 2].
        height: of the table top there [m], shape [...].

    Returns:
        Shape [..., 7].
    """
    xp = array_namespace(pose, tilt)
    zero = xp.zeros_like(pose[..., :1])
    turn = quaternion_from_rotation_vector(xp.concat([tilt, zero], axis=-1))
    up = xp.concat([zero, zero, pose[..., 2:3] - height[..., None]], axis=-1)
    position = pose[..., :3] - up + rotate(turn, up)
    return xp.concat([position, quaternion_multiply(turn, pose[..., 3:])], axis=-1)
