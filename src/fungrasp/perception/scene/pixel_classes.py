"""How probable it is that a pixel shows the held object, skin, or the background: by color, depth and place.

Depth alone fails where a camera smooths it over a hand and a small object, color alone where things look
alike. So each class says how likely a pixel's color and depth are, and Bayes' rule puts them together:

- background: colors seen on the table around, and the height of the table;
- skin: colors seen at the hand's bones, and the distance from the hand in the image;
- the object: any color alike, then those of what was found, or of its mesh; within reach of the fingertips.

Camera frame: OpenCV [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.grasps.human_hand import BONES
from fungrasp.perception.hand.hand_capsules import SURE_SKIN, capsule_distances
from fungrasp.perception.io.capture import Capture, depth_noise

REACH = 12  # A step is looked for within so many pixels to both sides [pixels of an image 640 wide].
SIDE = 5  # Length of the even stretch that must follow on both sides [pixels].
# Least and largest step that is looked at [m]: smaller ones drown in noise, larger ones are seldom outlines
# of what is near.
STEPS = (0.025, 0.35)
FARTHEST = 1.5  # Depth beyond this [m] is not looked at.
LEAST_STEPS = 40  # Fewer steps don't tell how wide they are.
EVEN = 0.15  # How much the depth may change beside a step, per pixel, as a part of the step's own mean slope.
SHARP = 2.0  # Width of steps that is taken where they can't be measured [pixels].
SMOOTHED = 6.0  # Wider steps are worth a warning [pixels]; rendered ones are 0 to 4 pixels wide.
# Standard deviation of the depth near a step, as a part of the step: of an even mixture of both sides.
MIXED = 0.3


def filled(depth: np.ndarray) -> np.ndarray:
    """The depth image with the nearest measurement where there is none [m], shape [H, W]."""
    nearest: Any = ndimage.distance_transform_edt(depth <= 0, return_distances=False, return_indices=True)
    return depth[tuple(nearest)]


def edge_width(depth: np.ndarray) -> float:
    """How many pixels steps in depth are mixed over: from 10 to 90 % of the step, median over the image.

    Args:
        depth: [m], shape [H, W]; 0: not measured.

    Returns:
        [pixels]; ``SHARP`` where there are too few steps.
    """
    if not (depth > 0).any():
        return SHARP
    whole = filled(depth)
    widths = np.concatenate([_step_widths(whole), _step_widths(np.ascontiguousarray(whole.T))])
    return float(max(SHARP, np.median(widths))) if len(widths) >= LEAST_STEPS else SHARP


def _step_widths(depth: np.ndarray) -> np.ndarray:
    """Widths of the steps along the rows [pixels], at most some hundred of them."""
    margin, last = REACH + SIDE, depth.shape[1]
    if last <= 2 * margin:
        return np.zeros(0)
    left, right = depth[:, SIDE : last - SIDE - 2 * REACH], depth[:, SIDE + 2 * REACH : last - SIDE]
    step = np.abs(right - left)
    limit = EVEN * step / (2 * REACH) * SIDE
    even = (np.abs(left - depth[:, : last - 2 * margin]) < limit) & (
        np.abs(depth[:, 2 * margin :] - right) < limit
    )
    even &= (step > STEPS[0]) & (step < STEPS[1]) & (np.maximum(left, right) < FARTHEST)
    slope = np.abs(np.diff(depth, axis=1, append=depth[:, -1:]))
    steepest = slope == ndimage.maximum_filter1d(slope, 2 * REACH - 1, axis=1)
    rows, columns = np.nonzero(even & steepest[:, margin : last - margin])
    every = max(1, len(rows) // 400)
    rows, columns = rows[::every], columns[::every] + margin
    lines = depth[rows[:, None], columns[:, None] + np.arange(-REACH, REACH + 1)]
    part = (lines - lines[:, :1]) / (lines[:, -1:] - lines[:, :1])
    return ((part > 0.1) & (part < 0.9)).sum(axis=1)


def depth_spread(depth: np.ndarray, width: float) -> np.ndarray:
    """Standard deviation of each pixel's depth [m], shape [H, W]: the sensor's noise, and near steps the
    mixture of both sides.

    Args:
        depth: [m], shape [H, W]; 0: not measured.
        width: of the steps, see ``edge_width`` [pixels].
    """
    noise = depth_noise(depth)
    if width <= SHARP:
        return noise
    whole, size = filled(depth), 2 * round(0.5 * width) + 1
    step = ndimage.maximum_filter(whole, size) - ndimage.minimum_filter(whole, size)
    # What an even surface seen at 45 degrees changes within the window is no step.
    return np.hypot(noise, MIXED * np.maximum(step - noise, 0.0))


# Levels of each channel in a table of colors: fine enough to tell shades of blue, coarse enough for some
# hundred samples.
LEVELS = 12
UNKNOWN = 0.03  # Part of a class's colors that were not among its samples: shadows, highlights, other things.
# Beyond the hand's surface by the first, a pixel is as likely skin as not; width of that decision [m]: hands
# are found to 4 to 7 pixels, some 5 mm.
SKIN_EDGE = (0.004, 0.005)
# The object may be so high above the table as well as lower [m]: its depth is spread evenly over that.
HEIGHTS = 0.08
# No depth or place speaks more strongly against a class (logarithm): colors may still win by far.
FARTHEST_OUT = 8.0
# Standard deviation of a mesh's colors from those of the image: logarithms of red and blue over green. Light
# and white balance shift them by some tenths.
TONE = 0.12
DARKEST = 8.0  # Added to colors, 0 to 255, before the logarithm is taken: darker ones have no tone.
# Part of a surface's colors that are brighter or darker than where it was looked at: shadows of the hand.
SHADED = 0.2
# Part of the objects that have the color of the hand that holds them, and of those that have the table's: so
# much colors may say against a pixel, and no more.
ALIKE = 0.1
# Skin is of one tone, overexposed or not, to so many ``TONE``; what else was sampled is in front of it.
SKIN_TONES = 2.0
TONE_BINS = 15  # Bins of each tone, for +- 1.5.
ROUNDS = 2  # How often the object's colors are learned from what was found: more rounds changed nothing.
LEAST_SAMPLES = 25  # Fewer pixels say nothing about the object's colors.
NEVER = -16.0  # Logarithm of the odds of a pixel that can't show the object.
# Neighboring pixels (standard deviation) show the same thing: they share their evidence [pixels].
SMOOTHING = 1.2
# Color of each cell, shape [LEVELS^3, 3].
_CELL_COLORS = (np.stack(np.unravel_index(np.arange(LEVELS**3), (LEVELS,) * 3), axis=-1) + 0.5) * (
    256.0 / LEVELS
)


@dataclass(frozen=True, eq=False)
class PixelClasses:
    """Probability of each class for every pixel, they sum to 1; shape [H, W] each."""

    obj: np.ndarray
    """The object, or another thing within reach of the hand."""
    skin: np.ndarray
    """The hand and the forearm."""
    background: np.ndarray
    """The table, the room and all that is out of reach."""


@dataclass(frozen=True, eq=False)
class PixelEvidence:
    """What is known of each pixel besides its color, shape [H, W] each."""

    prior: np.ndarray
    """Logarithm of the odds that it shows the object, by what was said and by the reach of the fingertips;
    ``NEVER`` or less: it can't."""
    samples: np.ndarray
    """Whether it was said to show the object, bool."""
    height: np.ndarray
    """Height above the table [m]; NaN: not known."""
    spread: np.ndarray
    """Standard deviation of the depth [m]."""
    skin_distance: np.ndarray
    """Distance from the hand's surface, negative inside [m]; infinite without a hand."""
    sleeve: np.ndarray
    """Whether it is where the forearm and its sleeve are, bool."""
    palm: np.ndarray
    """Whether it surely shows the hand, bool."""
    ground: np.ndarray
    """Whether it surely shows the background, bool."""


def classify(
    capture: Capture, evidence: PixelEvidence, mesh_colors: np.ndarray | None = None
) -> PixelClasses:
    """Put colors, depth and place together.

    mesh_colors: RGB of the object's surface, 0 to 1, shape [M, 3], if it has colors.
    """
    color = ndimage.gaussian_filter(capture.color.astype(np.float32), (SMOOTHING / 2, SMOOTHING / 2, 0))
    index = color_cells(color)
    ground = table_of_colors(index[evidence.ground], SHADED)[index]
    palm = index[evidence.palm]
    skin = table_of_colors(_alike(palm) if len(palm) else palm, SHADED)[index]
    # Of any color, the hand's and the table's among them.
    obj = (1.0 - 2 * ALIKE) / LEVELS**3 + ALIKE * (skin + ground)
    if mesh_colors is not None:
        obj = 0.5 * obj + 0.5 * _mesh_likelihood(color, mesh_colors) / LEVELS**3
    if evidence.samples.sum() >= LEAST_SAMPLES:
        obj = 0.5 * obj + 0.5 * table_of_colors(index[evidence.samples])[index]
    known_height = np.isfinite(evidence.height)
    offset = np.where(known_height, evidence.height, 0.0) / evidence.spread
    on_table = np.maximum(-0.5 * np.square(offset), -FARTHEST_OUT)
    above = np.log(np.sqrt(2 * np.pi) * np.minimum(evidence.spread, 0.3 * HEIGHTS) / HEIGHTS)
    above = np.where(known_height, above, -1.0) - np.where(offset < -3.0, 0.5 * FARTHEST_OUT, 0.0)
    above = above + np.maximum(evidence.prior, NEVER)
    above = np.where(evidence.sleeve, above - 0.5 * FARTHEST_OUT, above)
    inside = (SKIN_EDGE[0] - evidence.skin_distance) / SKIN_EDGE[1]
    on_hand = np.maximum(-np.logaddexp(0.0, -inside), -FARTHEST_OUT)
    not_hand = np.maximum(-np.logaddexp(0.0, inside), -2.0)
    result, anything = PixelClasses(obj, obj, obj), obj
    for _ in range(ROUNDS):
        logits = np.stack(
            [np.log(obj) + above + not_hand, np.log(skin) + on_hand - 1.0, np.log(ground) + on_table]
        )
        logits = ndimage.gaussian_filter(logits, (0, SMOOTHING, SMOOTHING))
        odds = np.exp(logits - logits.max(axis=0))
        odds /= odds.sum(axis=0)
        result = PixelClasses(*odds)
        sure = ((result.obj > 0.8) & (evidence.prior > NEVER)) | evidence.samples
        if sure.sum() < LEAST_SAMPLES:
            break
        obj = 0.5 * anything + 0.5 * table_of_colors(index[sure])[index]
    return result


def color_cells(color: np.ndarray) -> np.ndarray:
    """Cell of each color in a table of colors. color: RGB, 0 to 255, shape [..., 3]. Returns shape
    [...]."""
    cell = np.minimum((color * (LEVELS / 256.0)).astype(np.int64), LEVELS - 1)
    return (cell[..., 0] * LEVELS + cell[..., 1]) * LEVELS + cell[..., 2]


def table_of_colors(samples: np.ndarray, brightness: float = 0.0) -> np.ndarray:
    """How likely each color is, shape [LEVELS^3], from cells of pixels; all alike without samples.

    brightness: part of the colors that have the tone of the samples in any brightness.
    """
    cells = LEVELS**3
    if len(samples) < 20:
        return np.full(cells, 1.0 / cells)
    counts = np.bincount(samples, minlength=cells).astype(float)
    smooth = ndimage.gaussian_filter(counts.reshape(LEVELS, LEVELS, LEVELS), 0.6).ravel() / counts.sum()
    tones = np.bincount(_TONE_OF_CELL, counts, minlength=TONE_BINS**2).reshape(TONE_BINS, TONE_BINS)
    tones = ndimage.gaussian_filter(tones, 0.7).ravel() / counts.sum()
    shaded = (tones / np.maximum(_CELLS_OF_TONE, 1.0))[_TONE_OF_CELL]
    return (1.0 - UNKNOWN - brightness) * smooth + brightness * shaded + UNKNOWN / cells


def tone(color: np.ndarray) -> np.ndarray:
    """Logarithms of red and blue over green, shape [..., 2]; color: RGB, 0 to 255, shape [..., 3]."""
    return np.log(color[..., [0, 2]] + DARKEST) - np.log(color[..., 1:2] + DARKEST)


def _alike(samples: np.ndarray) -> np.ndarray:
    """Those cells of pixels whose tone is that of most: the others show something in front of the hand."""
    tones = tone(_CELL_COLORS)[samples]
    some = tones[:: max(1, len(tones) // 300)]
    apart = np.linalg.norm(some[:, None] - some, axis=-1)
    usual = some[np.exp(-0.5 * (apart / TONE) ** 2).sum(axis=1).argmax()]
    return samples[np.linalg.norm(tones - usual, axis=1) < SKIN_TONES * TONE]


def _mesh_likelihood(color: np.ndarray, mesh_colors: np.ndarray) -> np.ndarray:
    """How much likelier a pixel's tone is with the mesh's colors than with any, shape [H, W]."""
    some = mesh_colors[:: max(1, len(mesh_colors) // 40)] * 255.0
    tones, known = tone(color), tone(some)
    near = np.zeros(color.shape[:2])
    for value in known:
        near += np.exp(-0.5 * np.square((tones - value) / TONE).sum(axis=-1))
    # Tones lie within about +- 1 in both: a Gaussian's density in that of an even spread.
    return near / len(known) * 4.0 / (2 * np.pi * TONE**2)


def _tone_bins() -> tuple[np.ndarray, np.ndarray]:
    """Bin of tone of each cell of colors, shape [LEVELS^3] int; number of cells in each bin."""
    bins = np.clip(((tone(_CELL_COLORS) / 3.0 + 0.5) * TONE_BINS).astype(int), 0, TONE_BINS - 1)
    flat = bins[:, 0] * TONE_BINS + bins[:, 1]
    return flat, np.bincount(flat, minlength=TONE_BINS**2).astype(float)


_TONE_OF_CELL, _CELLS_OF_TONE = _tone_bins()


def hand_in_image(capture: Capture, joints: np.ndarray) -> np.ndarray:
    """Distance of every pixel from the outline of a hand in the image, negative inside [m at the hand's
    depth], shape [H, W]. joints: of the hand [m], camera frame, shape [21, 3]."""
    k = capture.intrinsics
    depth = float(np.median(joints[:, 2]))
    # The hand and its pixels in the plane through its middle that is parallel to the image.
    ends = (k.project(end) for end in SURE_SKIN.ends(joints))
    first, last = (k.deproject(end, np.full(len(end), depth)) for end in ends)
    every = k.rays()[::2, ::2]
    best = capsule_distances(depth * every.reshape(-1, 3), first, last, SURE_SKIN.radius)
    best = best.reshape(every.shape[:2])
    return best.repeat(2, axis=0).repeat(2, axis=1)[: k.height, : k.width]


def palm_pixels(capture: Capture, joints: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Pixels that surely show the hand, bool, shape [H, W]: near its bones in the image, and at the depth
    that
    most of those have, so that what is in front of the hand does not count.

    Args:
        joints: of the hand [m], camera frame, shape [21, 3].
        outline: distance from its outline in the image, see ``hand_in_image``.
    """
    near = (outline < -0.003) & capture.measured
    rows, columns = np.nonzero(near)
    if len(rows) < 20:
        return near
    pixels = capture.intrinsics.project(joints)
    first, last = np.transpose(BONES)
    # Depth of the nearest middle of a bone.
    middles, depths = 0.5 * (pixels[first] + pixels[last]), 0.5 * (joints[first, 2] + joints[last, 2])
    apart = np.hypot(columns[:, None] - middles[:, 0], rows[:, None] - middles[:, 1])
    ahead = capture.depth[rows, columns] - depths[apart.argmin(axis=1)]
    usual = np.abs(ahead - np.median(ahead)) < 0.012
    result = np.zeros_like(near)
    result[rows[usual], columns[usual]] = True
    return result
