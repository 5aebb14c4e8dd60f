"""Hands that another program detected in the image: HaMeR, WiLoR, or just 21 joints.

These programs guess the hand's size and distance, often for a camera of another focal length. The hand's
shape and its position in the image are kept; size and distance are fitted to the depth image (``fit_hand``).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import read_json
from fungrasp.grasps.human_hand import (
    HAND_SIZE_SPREAD,
    ORDERS,
    hand_size,
    joint_bends,
    joint_order,
    order_misfit,
)
from fungrasp.perception.hand.detected_hand import MIRROR_X, DetectedHand, choose_hand, object_box
from fungrasp.perception.hand.fit import fit_hand
from fungrasp.perception.hand.fit_problem import joint_confidence
from fungrasp.perception.hand.hand_capsules import SURFACE_SAMPLES, in_front
from fungrasp.perception.hand.hand_measurements import median_depth
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.estimates import HandEstimate, Side

_log = logging.getLogger(__name__)

VERSION = 1  # Version of the file format.

SOURCES = ("hamer", "wilor", "joints")

# Names of fields in the files of other programs.
ALIASES = {
    "joints": ("pred_keypoints_3d", "pred_3d_joints"),
    "translation": ("pred_cam_t_full", "transl"),
    "focal_length": ("scaled_focal_length",),
    "pixels": ("pred_keypoints_2d",),
    "right": ("is_right",),
    "image_size": ("img_size",),
    "score": (),
}

BEND_SPREAD = 0.1  # Standard deviation of bone directions from such programs [rad].
# Distance from the skin within which depth agrees: thickness of the hand, errors of shape and camera [m].
AGREEMENT = 0.012
METRIC_SPREAD = 0.01  # Standard deviation of joints of known distance [m].


@guarded("hand file")
def read_hand_estimate(path: str | Path, capture: Capture, *, side: Side | None = None) -> HandEstimate:
    """Read a hand that HaMeR, WiLoR or another program detected in the capture's color image.

    The file is JSON or ``.npz`` with named arrays, see docs/your-estimator.md. Size and distance of the hand
    are fitted to the depth image, unless the file says ``metric``.

    Args:
        capture: image that the program saw, with depth; a mask shows the object, which is not the hand.
        side: side of the hand, if the file has several. Of that side, the hand nearest to the capture's mask,
            box or point is used, or the largest.

    Returns:
        Hand in the camera frame; a left hand is not mirrored. The score is the file's, times the agreement
        with the depth (if ``metric``, of the skin), reduced for an unusual size.

    Raises:
        FungraspError: the file can't be read, is incomplete, is for another image or has no hand of that
            side; or there is no depth at the hand.
    """
    fields = read_fields(path)
    hands = hands_of(fields, capture.intrinsics)
    if not hands:
        raise FungraspError(f"{path} has no hand")
    if side is not None and all(one.side != side for one in hands):
        raise FungraspError(f"{path} has no {side} hand, only {hands[0].side} ones")
    chosen, warnings = choose_hand(hands, object_box(capture, None, None), side)
    for one in warnings:
        _log.warning("%s: %s", path, one)
    if capture.mask is not None:
        depth = np.where(capture.mask, np.float32(0.0), capture.depth)
        capture = replace(capture, depth=depth, mask=None)
    found = _as_given(chosen, capture) if fields.flag("metric", False) else fit_hand(chosen, capture)
    # A size far from that of people probably means a wrong detection.
    unusual = max(abs(np.log(hand_size(found.joints_camera))) / HAND_SIZE_SPREAD - 2.0, 0.0)
    return replace(found, score=found.score * float(np.exp(-0.5 * unusual**2)))


def _as_given(detected: DetectedHand, capture: Capture) -> HandEstimate:
    """Return the hand in its given size, with its score times the fraction of skin at the measured depth."""
    joints = _of_given_size(detected, capture)
    samples, _ = SURFACE_SAMPLES.place(joints, np.zeros((21, 3, 0)))
    radius = SURFACE_SAMPLES.radius * hand_size(joints)
    depth = np.where(capture.measured, capture.depth, np.nan)
    off = median_depth(depth, capture.intrinsics.project(samples)) - samples[:, 2] + radius
    off = np.abs(off[in_front(samples, radius) & np.isfinite(off)])
    score = detected.score * float((off < AGREEMENT).mean()) if len(off) else 0.0
    covariance = np.tile(METRIC_SPREAD**2 * np.eye(3), (21, 1, 1))
    confidence = joint_confidence(covariance)
    return HandEstimate(joints, detected.pixels, confidence, covariance, detected.side, score)


def _of_given_size(detected: DetectedHand, capture: Capture) -> np.ndarray:
    """Return joints [m], camera frame, shape [21, 3]: the given shape, placed to fit its landmarks."""
    slopes = capture.intrinsics.deproject(detected.pixels, np.ones(21))
    shape = turn_to(slopes.mean(axis=0)).apply(detected.shape_camera)
    # (x + tx) = u (z + tz), and likewise for y, is linear in the translation.
    u, v = slopes[:, 0], slopes[:, 1]
    one, zero = np.ones(21), np.zeros(21)
    rows = np.concatenate([np.stack([one, zero, -u], axis=1), np.stack([zero, one, -v], axis=1)])
    values = np.concatenate([u * shape[:, 2] - shape[:, 0], v * shape[:, 2] - shape[:, 1]])
    translation = np.linalg.lstsq(rows, values, rcond=None)[0]
    points = shape + translation
    if not (np.isfinite(points).all() and points[:, 2].min() > 0.02):
        raise FungraspError(
            "the hand's landmarks in the image don't fit its shape at any position in front of the camera"
        )
    return points


@dataclass(frozen=True, eq=False)
class HandFields:
    """Fields of a hand file."""

    where: str
    """Name of the file, for messages."""
    source: str
    """Program that wrote it, one of ``SOURCES``."""
    values: Mapping[str, Any]
    """Arrays and numbers by their names in the file."""

    def has(self, name: str) -> bool:
        """Return whether the file has the field, by any of its names."""
        return self._key(name) is not None

    def text(self, name: str, default: str) -> str:
        """Return a text."""
        return str(np.asarray(self.values.get(name, default)).item())

    def flag(self, name: str, default: bool) -> bool:
        """Return whether an option is set, for all hands."""
        return bool(np.asarray(self.values.get(name, default)).ravel()[0])

    def numbers(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return the numbers of a field, one row per hand, shape [hands, *shape].

        Raises:
            FungraspError: the field is missing, of another shape or not finite.
        """
        key = self._key(name)
        if key is None:
            names = " or ".join(f"'{other}'" for other in (name, *ALIASES.get(name, ())))
            raise FungraspError(f"{self.where}: the field {names} is missing")
        try:
            array = np.array(self.values[key], dtype=float)
        except (TypeError, ValueError) as error:
            raise FungraspError(
                f"{self.where}: '{key}' must be numbers, all rows of the same length"
            ) from error
        # WiLoR-mini keeps an axis of length 1 after that of the hands.
        squeezed = array.reshape([n for i, n in enumerate(array.shape) if n != 1 or i == 0])
        for found in (array[None], array, squeezed):
            if found.ndim == len(shape) + 1 and found.shape[1:] == shape:
                break
        else:
            wanted = list(shape) if shape else "one number"
            raise FungraspError(
                f"{self.where}: '{key}' must have shape {wanted} per hand, not {list(array.shape)}"
            )
        if not np.isfinite(found).all():
            raise FungraspError(f"{self.where}: '{key}' has non-finite numbers")
        return found

    def _key(self, name: str) -> str | None:
        return next((key for key in (name, *ALIASES.get(name, ())) if key in self.values), None)


def read_fields(path: str | Path) -> HandFields:
    """Read a hand file.

    Raises:
        FungraspError: it can't be read, has a newer version, or an unknown source.
    """
    path = Path(path)
    if not path.is_file():
        raise FungraspError(f"the hand file {path} does not exist")
    values = _content(path)
    version = values.get("version", VERSION)
    try:
        version = int(np.asarray(version).item())
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{path}: 'version' must be a whole number, not {version!r}") from error
    if version > VERSION:
        raise FungraspError(f"{path} is of version {version}; this fungrasp reads up to version {VERSION}")
    if "source" not in values:
        raise FungraspError(
            f"{path}: the field 'source' is missing; it says what wrote the hand: {', '.join(SOURCES)}"
        )
    source = str(np.asarray(values["source"]).item()).lower()
    if source not in SOURCES:
        raise UnknownNameError("source of hands", source, SOURCES)
    return HandFields(str(path), source, values)


def _content(path: Path) -> Mapping[str, Any]:
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return read_npz(path, "hand file")
    if suffix == ".json":
        content = read_json(path, "hand file")
        if not isinstance(content, dict):
            raise FungraspError(f"{path}: a hand file has named fields, not {type(content).__name__}")
        return content
    lacks = {
        ".npy": "an array without names does not tell which hand it is and by which camera it was seen",
        ".pkl": "a pickle can run anything when it is opened",
    }
    hint = f"; {lacks[suffix]}" if suffix in lacks else ""
    raise FungraspError(f"{path}: a hand file is .json or .npz, not '{suffix}'{hint}")


SIZES = (0.4, 2.0)  # Smallest and largest size relative to an adult's; beyond, the unit is wrong.
# Mean backward bend of the fingers beyond which they belong to a hand of the other side [rad].
BENT_BACK = np.radians(20.0)
UNLIKE = 0.5  # Largest misfit of landmarks and joints, relative; perspective and errors cause a tenth of it.
ASPECT = 0.02  # Largest relative difference between aspect ratios of the same image.


def hands_of(fields: HandFields, intrinsics: Intrinsics) -> list[DetectedHand]:
    """Return all hands of a file.

    Args:
        fields: fields of the file, see docs/your-estimator.md.

    Returns:
        Landmarks in the image; shapes as if the hand were in the center of the image, as of ``HandDetector``;
        scores of the file, 1 if it has none.

    Raises:
        FungraspError: a field is missing or invalid, or the file is for another image.
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
        score = float(scores[row])
        hands.append(DetectedHand(pixels[row], shape, side, 1.0, score, direction_spread=BEND_SPREAD))
    return hands


def _joints(fields: HandFields) -> np.ndarray:
    """Return the joints of each hand [m], camera axes, not translated, shape [hands, 21, 3]."""
    order = fields.text("order", "openpose")
    given = fields.numbers("joints", (21, 3))
    joints = given[:, joint_order(order)]
    # Fingers differ in bone lengths, which reveals a wrong order.
    unlike = {name: float(order_misfit(given[:, places]).mean()) for name, places in ORDERS.items()}
    best = min(unlike, key=lambda name: unlike[name])
    if unlike[best] < unlike[order]:
        raise FungraspError(
            f"{fields.where}: the bones between the joints have the lengths of a hand in the order '{best}', "
            f"not '{order}': say 'order': '{best}'"
        )
    return joints


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
    """Return a field's rows, one per hand; a single one is repeated."""
    values = fields.numbers(name, shape)
    if len(values) not in (1, count):
        raise FungraspError(f"{fields.where}: '{name}' is for {len(values)} hands, the joints for {count}")
    return np.broadcast_to(values, (count, *shape))


def _seen(fields: HandFields, joints: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Return landmarks [pixels], shape [hands, 21, 2], and the direction in which each hand was seen, camera
    axes, shape [hands, 3]."""
    count = len(joints)
    ahead = np.tile([0.0, 0.0, 1.0], (count, 1))
    scale, size = _image(fields, intrinsics)
    order = joint_order(fields.text("order", "openpose"))
    pixels = fields.numbers("pixels", (21, 2))[:, order] * scale if fields.has("pixels") else None
    if pixels is not None and ((pixels >= 0) & (pixels <= scale)).all():
        # MediaPipe gives fractions of the image's width and height.
        pixels = pixels / scale * size
    given = fields.has("translation")
    relative = fields.source != "joints" or (joints[..., 2] <= 0).any()
    if pixels is not None and relative and not given:
        _check_alike(pixels, joints, fields.where)
        return pixels, ahead
    needed = given or fields.source != "joints"
    placed = joints + _each(fields, "translation", (3,), count)[:, None] if needed else joints
    if (placed[..., 2] <= 0).any():
        raise FungraspError(
            f"{fields.where}: a joint is behind the camera; the translation must be in the camera frame "
            "with z forward"
            if given
            else f"{fields.where}: the joints are relative to the hand, and nothing says where it is: give "
            "its 'pixels' in the image, or its 'translation' in the camera frame with z forward"
        )
    directions = placed.mean(axis=1)
    if pixels is None:
        focal, center = _lens(fields, intrinsics, size, count, scale)
        pixels = placed[..., :2] / placed[..., 2:] * focal[:, None] + center
    return pixels, directions


def _lens(
    fields: HandFields, intrinsics: Intrinsics, size: np.ndarray, count: int, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return focal lengths, shape [hands, 2], and optical axis, shape [2], of the camera that
    the program assumed [pixels of the capture]."""
    if fields.has("focal_length"):
        return _each(fields, "focal_length", (), count)[:, None] * scale, size / 2
    if fields.source in ("hamer", "wilor"):
        # These programs assume a camera, so the focal length is required.
        fields.numbers("focal_length", ())
    own = np.array([[intrinsics.fx, intrinsics.fy]])
    return np.repeat(own, count, axis=0), np.array([intrinsics.cx, intrinsics.cy])


def _image(fields: HandFields, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Return the capture's pixels per pixel of the file's image, shape [2], and its size, shape [2]."""
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
    """Return the smallest rotation from the optical axis to a direction, shape [3]."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return Rotation.identity()
    return Rotation.from_rotvec(axis / length * np.arctan2(length, direction[2]))


def _check_shape(joints: np.ndarray, side: str, where: str) -> None:
    size = hand_size(joints)
    if not SIZES[0] < size < SIZES[1]:
        unit = "; are the joints in millimeters?" if 400 < size < 2000 else "; joints must be in meters"
        raise FungraspError(f"{where} is {size:.3g} times as large as an adult's{unit}")
    flexion, _ = joint_bends(joints if side == "right" else joints * MIRROR_X)
    bend = float(flexion[:4].mean())
    if bend < -BENT_BACK:
        raise FungraspError(
            f"{where}: as a {side} hand its fingers are bent back by {np.degrees(-bend):.0f} degrees; "
            "either it "
            "is the other hand, or its x was not flipped: networks see left hands mirrored (say "
            "'mirrored': true if the file has them so)"
        )


def _check_alike(pixels: np.ndarray, joints: np.ndarray, where: str) -> None:
    """Check that landmarks are arranged in the image like the joints in space.

    pixels: shape [hands, 21, 2]; joints: [m], camera axes, shape [hands, 21, 3].
    """
    for row, (seen, shape) in enumerate(zip(pixels, joints[..., :2], strict=True)):
        seen, shape = seen - seen.mean(axis=0), shape - shape.mean(axis=0)
        # Scale of a distant camera.
        scale = np.sum(seen * shape) / np.sum(shape**2)
        if scale <= 0 or np.linalg.norm(seen - scale * shape) > UNLIKE * np.linalg.norm(seen):
            raise FungraspError(
                f"{where}, hand {row}: its pixels do not lie as its joints do: pixels are (column, row), "
                "joints have the camera's axes, x right, y down, z forward"
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
