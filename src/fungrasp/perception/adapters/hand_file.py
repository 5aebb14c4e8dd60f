"""Hands that another program found in the image: HaMeR, WiLoR, or just 21 joints.

These programs guess the hand's size and distance, mostly for a camera of another focal length. What they know
is the hand's shape and where it is in the image: this is what is kept here. ``place_hand`` then finds size
and distance in the depth image.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.grasps.human_hand import ORDERS, bone_ratios, hand_size, joint_bends, joint_order
from fungrasp.perception.adapters.hand_fields import HandFields
from fungrasp.perception.estimates import Side
from fungrasp.perception.hand.detected_hand import MIRROR_X, DetectedHand
from fungrasp.perception.io.capture import Intrinsics

SIZES = (0.4, 2.0)
"""Smallest and largest hand as a part of an adult's; beyond, the unit is wrong."""

BENT_BACK = np.radians(20.0)
"""Fingers bent back by more than this in the mean [rad] belong to a hand of the other side."""

ASPECT = 0.02
"""Part by which the shapes of two images that are the same one may differ."""


def hands_of(fields: HandFields, intrinsics: Intrinsics) -> list[DetectedHand]:
    """All hands of a file.

    Args:
        fields: of the file; docs/adapters.md has them.
        intrinsics: of the image.

    Returns:
        Landmarks in the image; shapes as if the hand were in the middle of it, as of our own detector; scores
        are the file's, 1 where it has none.

    Raises:
        FungraspError: it lacks a field, or can't be of this image.
    """
    joints = _joints(fields)
    count = len(joints)
    sides = _sides(fields, count)
    if fields.flag("mirrored", False):
        joints = np.where((sides == "left")[:, None, None], joints * MIRROR_X, joints)
    for row, (hand, side) in enumerate(zip(joints, sides, strict=True)):
        _check_shape(hand, side, f"{fields.where}, hand {row}")
    scores = _each(fields, "score", (), count) if fields.has("score") else np.ones(count)
    if ((scores < 0) | (scores > 1)).any():
        raise FungraspError(f"{fields.where}: a score must be from 0 to 1, not {scores.min():g}")
    pixels, directions = _seen(fields, joints, intrinsics)
    hands = []
    for row in range(count):
        _check_pixels(pixels[row], intrinsics, f"{fields.where}, hand {row}")
        shape = turn_to(directions[row]).inv().apply(joints[row] - joints[row].mean(axis=0))
        side: Side = "right" if sides[row] == "right" else "left"
        hands.append(DetectedHand(pixels[row], shape, side, 1.0, float(scores[row])))
    return hands


def _joints(fields: HandFields) -> np.ndarray:
    """Joints of each hand [m], axes of the camera, the file's translation not added, shape [hands, 21, 3]."""
    order = fields.text("order", "openpose")
    given = fields.numbers("joints", (21, 3))
    joints = given[:, joint_order(order)]
    # The fingers' bones differ in length: in another order they have those of other fingers.
    unlike = {name: _unlike_adults(given[:, places]) for name, places in ORDERS.items()}
    best = min(unlike, key=lambda name: unlike[name])
    if unlike[best] < unlike[order]:
        raise FungraspError(
            f"{fields.where}: the bones between the joints have the lengths of a hand in the order '{best}', "
            f"not '{order}': say 'order': '{best}'"
        )
    return joints


def _unlike_adults(joints: np.ndarray) -> float:
    """How much the proportions of hands differ from adults': sum of squares of the logarithm of the
    bones' lengths over adults', the hand's size taken out. joints: [m], shape [hands, 21, 3]."""
    ratios = bone_ratios(joints)
    if not (ratios > 0).all():
        return float("inf")
    away = np.log(ratios)
    return float(np.square(away - np.median(away, axis=-1, keepdims=True)).sum())


def _sides(fields: HandFields, count: int) -> np.ndarray:
    if "side" in fields.values:
        sides = np.atleast_1d(np.asarray(fields.values["side"], dtype=str))
        sides = np.char.lower(np.broadcast_to(sides, count) if len(sides) == 1 else sides)
        if len(sides) != count or not np.isin(sides, ("right", "left")).all():
            raise FungraspError(f"{fields.where}: 'side' must be 'right' or 'left' for each of {count} hands")
        return sides
    if not fields.has("right"):
        raise FungraspError(
            f"{fields.where} does not say which hand it is: give 'side' (right, left) or 'is_right' (1, 0)"
        )
    return np.where(_each(fields, "right", (), count) > 0.5, "right", "left")


def _each(fields: HandFields, name: str, shape: tuple[int, ...], count: int) -> np.ndarray:
    """One row per hand; one for all is repeated."""
    values = fields.numbers(name, shape)
    if len(values) not in (1, count):
        raise FungraspError(f"{fields.where}: '{name}' is for {len(values)} hands, the joints for {count}")
    return np.broadcast_to(values, (count, *shape))


def _seen(fields: HandFields, joints: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks [pixels], shape [hands, 21, 2], and the direction in which the program saw each hand, camera
    axes, shape [hands, 3]."""
    count = len(joints)
    ahead = np.tile([0.0, 0.0, 1.0], (count, 1))
    scale, size = _image(fields, intrinsics)
    order = joint_order(fields.text("order", "openpose"))
    pixels = fields.numbers("pixels", (21, 2))[:, order] * scale if fields.has("pixels") else None
    if fields.has("translation") or fields.source in ("hamer", "wilor"):
        if not fields.has("translation") and pixels is not None:
            return pixels, ahead
        placed = joints + _each(fields, "translation", (3,), count)[:, None]
    else:
        placed = joints
    if (placed[..., 2] <= 0).any():
        raise FungraspError(
            f"{fields.where}: a joint is behind the camera; the translation must be in the camera frame "
            "with z forward"
        )
    directions = placed.mean(axis=1)
    if pixels is None:
        focal, center = _lens(fields, intrinsics, size, count, scale)
        pixels = placed[..., :2] / placed[..., 2:] * focal[:, None] + center
    return pixels, directions


def _lens(
    fields: HandFields, intrinsics: Intrinsics, size: np.ndarray, count: int, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Focal length, shape [hands, 2], and optical axis, shape [2], of the camera that the program took the
    image for [pixels of the capture]."""
    if fields.has("focal_length"):
        return _each(fields, "focal_length", (), count)[:, None] * scale, size / 2
    if fields.source in ("hamer", "wilor"):
        # Their cameras are made up; without the focal length nothing fits.
        fields.numbers("focal_length", ())
    own = np.array([[intrinsics.fx, intrinsics.fy]])
    return np.repeat(own, count, axis=0), np.array([intrinsics.cx, intrinsics.cy])


def _image(fields: HandFields, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the capture per pixel of the file's image, shape [2], and the capture's size, shape [2]."""
    own = np.array([intrinsics.width, intrinsics.height], dtype=float)
    if not fields.has("image_size"):
        return np.ones(2), own
    given = fields.numbers("image_size", (2,))[0]
    if (given <= 0).any() or abs(given[0] * own[1] / (given[1] * own[0]) - 1) > ASPECT:
        raise FungraspError(
            f"{fields.where} is for an image of {given[0]:g} x {given[1]:g} pixels, the capture has "
            f"{own[0]:g} x {own[1]:g}: another image"
        )
    return own / given, own


def turn_to(direction: np.ndarray) -> Rotation:
    """The shortest turn from the optical axis to a direction, shape [3]."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return Rotation.identity()
    return Rotation.from_rotvec(axis / length * np.arctan2(length, direction[2]))


def _check_shape(joints: np.ndarray, side: str, where: str) -> None:
    size = hand_size(joints)
    if not SIZES[0] < size < SIZES[1]:
        unit = "; are the joints in millimetres?" if 400 < size < 2000 else "; joints must be in metres"
        raise FungraspError(f"{where} is {size:.3g} times as large as an adult's{unit}")
    flexion, _ = joint_bends(joints if side == "right" else joints * MIRROR_X)
    bend = float(flexion[:4].mean())
    if bend < -BENT_BACK:
        raise FungraspError(
            f"{where}: as a {side} hand its fingers are bent back by {np.degrees(-bend):.0f} degrees; "
            "either it "
            "is the other hand, or its x was not turned round: networks see left hands mirrored (say "
            "'mirrored': true if the file has them so)"
        )


def _check_pixels(pixels: np.ndarray, intrinsics: Intrinsics, where: str) -> None:
    inside = ((pixels >= 0) & (pixels < [intrinsics.width, intrinsics.height])).all(axis=1)
    if inside.mean() < 0.5:
        u, v = pixels.mean(axis=0)
        raise FungraspError(
            f"{where} lies outside the image of {intrinsics.width} x {intrinsics.height} pixels (about "
            f"{u:.0f}, {v:.0f}): was it found in an image of another size (field 'image_size'), or by "
            "another focal length?"
        )
