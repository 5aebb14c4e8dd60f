"""Measurements of one hand in an image: landmarks, depth, and points of the hand once the object is known."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.grasps.human_hand import BONES
from fungrasp.perception.hand.detected_hand import MIRROR_X, DetectedHand
from fungrasp.perception.hand.hand_capsules import capsule_distances
from fungrasp.perception.hand.image_evidence import FAR_BONES, NEAR_BONES
from fungrasp.perception.hand.physical_evidence import HandSurroundings
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.estimates import HandEstimate

# Largest difference in depth between nearest and farthest joint [m]; the landmark model sometimes gives 0.25.
DEEPEST = 0.16
REACH = 0.12  # Distance from all joints of a first guess beyond which a point is not of this hand [m].
OBJECT_NEAR = 0.006  # Distance from the object's surface within which points show the object [m].
TABLE_NEAR = 0.008  # Height above the table within which points show the table [m].
# Difference between neighboring pixels beyond which a depth camera measures a mixture of both sides [m].
EDGE = 0.015
POINTS = 400  # About how many points of the hand are used.
FEW = 12  # Number of candidates per point, as most show something else.
BONE = 0.006  # Distance from a guessed hand's bones within which points show the color of skin [m].
LEAST_SKIN = 40  # Smallest number of points from which the color of skin is learned.
MOST_SKIN = 400  # About the largest number of points from which the color of skin is learned.
OTHER_COLOR = 4.0  # Largest difference of a point from the skin's color [standard deviations].
# Smallest standard deviation of the skin's color: log(red / green) and log(blue / green).
COLOR_SPREAD = 0.04


@dataclass(frozen=True, eq=False)
class HandMeasurements:
    """Measurements of a hand; mirrored if it is a left one."""

    pixels: np.ndarray
    """Landmarks in the image [pixels], shape [21, 2]."""
    shape: np.ndarray
    """Joints about the hand's center [m], camera axes, shape [21, 3], as the landmark model guesses them."""
    directions: np.ndarray
    """Unit vectors of ``BONES`` in that shape, shape [20, 3]."""
    depth: np.ndarray
    """Depth [m], shape [H, W]; NaN where it was not measured."""
    intrinsics: Intrinsics
    """Intrinsics of the image, mirrored for a left hand."""
    score: float
    """Probability that this is a hand."""
    spread: float | None = None
    """Standard deviation of a landmark [pixels], if known."""
    direction_spread: float | None = None
    """Standard deviation of ``directions`` [rad], if known."""

    @classmethod
    def of(cls, detected: DetectedHand, capture: Capture) -> HandMeasurements:
        """Return the measurements of a detected hand, mirrored if it is a left one."""
        intrinsics, pixels, shape = capture.intrinsics, detected.pixels, detected.shape_camera
        depth = np.where(capture.depth > 0, capture.depth, np.nan)
        if detected.side == "left":
            last = intrinsics.width - 1
            intrinsics = dataclasses.replace(intrinsics, cx=last - intrinsics.cx)
            pixels = pixels * [-1.0, 1.0] + [last, 0.0]
            shape, depth = shape * MIRROR_X, depth[:, ::-1]
        deep = float(np.ptp(shape[:, 2]))
        shape = shape * [1.0, 1.0, min(1.0, DEEPEST / max(deep, 1e-6))]
        # The landmark model sees every hand as if it were in the center of the image.
        toward = intrinsics.deproject(pixels.mean(axis=0), np.ones(()))
        axis = np.cross([0.0, 0.0, 1.0], toward / np.linalg.norm(toward))
        shape = Rotation.from_rotvec(axis).apply(shape)
        bones = shape[FAR_BONES] - shape[NEAR_BONES]
        directions = bones / np.maximum(np.linalg.norm(bones, axis=1), 1e-6)[:, None]
        spreads = detected.spread, detected.direction_spread
        return cls(pixels, shape, directions, depth, intrinsics, detected.score, *spreads)

    def landmark_spread(self, part: float, least: float) -> float:
        """Return the standard deviation of a landmark [pixels], at least ``least``: the detector's value, or
        ``part`` of the hand's extent in the image."""
        extent = float(np.linalg.norm(np.ptp(self.pixels, axis=0)))
        return max(least, part * extent if self.spread is None else self.spread)

    def measured(self, pixels: np.ndarray) -> np.ndarray:
        """Return ``median_depth`` of this image [m], 0 without depth, shape [P]. pixels: shape [P, 2]."""
        return np.nan_to_num(median_depth(self.depth, pixels))


def median_depth(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the median depth of 3 x 3 pixels [m], NaN if fewer than three are measured, shape [P].

    Args:
        depth: [m], shape [H, W]; NaN where it was not measured.
        pixels: shape [P, 2].
    """
    height, width = depth.shape
    around = np.arange(-1, 2)
    middle = np.rint(np.nan_to_num(pixels, nan=-9.0)).astype(int)
    columns, rows = middle[:, 0, None, None] + around, middle[:, 1, None, None] + around[:, None]
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    values = depth[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    values = np.sort(np.where(inside, values, np.nan).reshape(len(pixels), -1), axis=1)
    count = np.isfinite(values).sum(axis=1)
    median = values[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    return np.where(count >= 3, median, np.nan)


@dataclass(frozen=True, eq=False)
class HandView:
    """An image of a right hand and a known object; the mirror image for a left hand."""

    depth: np.ndarray
    """Depth [m], shape [H, W]; NaN where it was not measured."""
    intrinsics: Intrinsics
    """Intrinsics of the image, mirrored for a left hand."""
    surroundings: HandSurroundings
    """Object and, if known, table."""
    points: np.ndarray
    """Measured points that may show the hand or its arm [m], camera frame, shape [P, 3]."""

    def mirrored(self) -> HandView:
        """Return the mirror image, with left and right swapped."""
        lens = dataclasses.replace(self.intrinsics, cx=self.intrinsics.width - 1 - self.intrinsics.cx)
        return HandView(self.depth[:, ::-1], lens, self.surroundings.mirrored(), self.points * MIRROR_X)

    def depth_at(self, pixels: np.ndarray) -> np.ndarray:
        """Return the depth of the nearest pixel [m], NaN without depth. pixels: shape [..., 2]."""
        height, width = self.depth.shape
        u, v = np.moveaxis(np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(int), -1, 0)
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        return np.where(inside, self.depth[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], np.nan)


def hand_view(capture: Capture, surroundings: HandSurroundings, guesses: list[np.ndarray]) -> HandView:
    """Find the points of the hand.

    They are near a guess, not on object or table, and have the most common color at the bones of the guesses:
    wrong landmarks are still on the hand, or on various other things.

    Args:
        surroundings: object and table, not mirrored.
        guesses: joints of possible hands [m], camera frame, shape [21, 3] each.
    """
    depth = np.where(capture.depth > 0, capture.depth, np.nan)
    joints = np.concatenate(guesses)
    lens = capture.intrinsics
    pixels = lens.project(joints)
    margin = REACH * lens.fx / float(np.median(joints[:, 2]))
    edge = np.array([lens.width, lens.height])
    low = np.clip(np.nanmin(pixels, axis=0) - margin, 0, edge - 2).astype(int)
    high = np.clip(np.nanmax(pixels, axis=0) + margin, low + 2, edge).astype(int)
    window = np.s_[low[1] : high[1], low[0] : high[0]]
    crop = depth[window]
    rows, columns = np.nonzero(~_edges(crop) & np.isfinite(crop))
    step = max(1, len(rows) // (FEW * POINTS))
    rows, columns = rows[::step] + low[1], columns[::step] + low[0]
    points = lens.deproject(np.stack([columns, rows], axis=1), depth[rows, columns])
    color = capture.color[rows, columns]
    near = np.zeros(len(points), dtype=bool)
    for guess in guesses:
        near |= np.linalg.norm(points[:, None] - guess[::2], axis=-1).min(axis=1) < REACH
    near &= np.abs(surroundings.object_distance(points)[0]) > OBJECT_NEAR
    table = surroundings.table_distance(points)
    if table is not None:
        near &= table[0] > TABLE_NEAR
    points, color, seen = points[near], color[near], np.stack([columns, rows], axis=1)[near]
    bones = [lens.project(guess)[np.transpose(BONES)] for guess in guesses]
    reach = BONE * lens.fx / float(np.median(joints[:, 2]))
    points = points[_skin_colored(seen, color, bones, reach)]
    every = max(1, len(points) // POINTS)
    return HandView(depth, lens, surroundings, points[::every])


def _edges(depth: np.ndarray) -> np.ndarray:
    """Return the pixels beside a jump in depth, bool, shape [h, w]."""
    jumps = np.zeros(depth.shape, dtype=bool)
    down, across = (np.abs(np.diff(depth, axis=axis)) > EDGE for axis in (0, 1))
    jumps[1:] |= down
    jumps[:-1] |= down
    jumps[:, 1:] |= across
    jumps[:, :-1] |= across
    return jumps


def _skin_colored(pixels: np.ndarray, color: np.ndarray, bones: list[np.ndarray], reach: float) -> np.ndarray:
    """Return which pixels have the color of the hand, bool, shape [P].

    Args:
        pixels: shape [P, 2].
        color: RGB, shape [P, 3].
        bones: pixels at both ends of the bones, shape [2, B, 2], per guess.
        reach: distance from a bone within which a pixel may show it [pixels].
    """
    votes = np.zeros(len(pixels))
    for ends in bones:
        # Capsules in the image plane.
        flat, near, far = (np.insert(points, 2, 0.0, axis=-1) for points in (pixels, *ends))
        votes += capsule_distances(flat, near, far, np.zeros((len(near), 2))) < reach
    on = np.flatnonzero(votes)
    if len(on) < LEAST_SKIN:
        return np.ones(len(pixels), dtype=bool)
    on = on[:: max(1, len(on) // MOST_SKIN)]
    red, green, blue = np.log(color.astype(float) + 8.0).T
    tone = np.stack([red - green, blue - green], axis=1)
    apart = np.linalg.norm(tone[on, None] - tone[on], axis=-1) / COLOR_SPREAD
    middle = tone[on[(np.exp(-0.5 * apart**2) @ votes[on]).argmax()]]
    alike = tone[on][np.linalg.norm(tone[on] - middle, axis=1) < OTHER_COLOR * COLOR_SPREAD]
    middle = np.median(alike, axis=0)
    spread = np.maximum(1.48 * np.median(np.abs(alike - middle), axis=0), COLOR_SPREAD)
    return np.linalg.norm((tone - middle) / spread, axis=1) < OTHER_COLOR


def mirror_estimate(hand: HandEstimate, pixels: np.ndarray) -> HandEstimate:
    """Mirror a hand left to right. pixels: its joints in the mirror image, shape [21, 2]."""
    return dataclasses.replace(
        hand,
        joints_camera=hand.joints_camera * MIRROR_X,
        covariance=hand.covariance * MIRROR_X[:, None] * MIRROR_X,
        pixels=pixels,
        side="left" if hand.side == "right" else "right",
    )
