"""Probability that a pixel shows the held object, skin or background, from color, depth and position.

Depth alone fails where a camera smooths it over hand and object, color alone where things look alike. Bayes'
rule combines their likelihoods under each class:

- background: colors of the table around the object, and the table's height;
- skin: colors at the hand's bones, and the distance from the hand in the image;
- object: any color at first, then the colors of its mesh or of pixels classified as object; within reach of
  the fingertips.

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

REACH = 12  # Half the width of the window around a step in depth [pixels].
SIDE = 5  # Length of the flat stretches required on both sides [pixels].
# Smallest and largest step considered [m]: smaller ones are noise, larger ones are rarely outlines of near
# things.
STEPS = (0.025, 0.35)
FARTHEST = 1.5  # Largest depth considered [m].
LEAST_STEPS = 40  # Smallest number of steps from which their width is estimated.
EVEN = 0.15  # Largest slope of a flat stretch, as a fraction of the step's mean slope.
SHARP = 2.0  # Smallest width of a step, assumed where it cannot be measured [pixels].
SMOOTHED = 6.0  # Width of a step beyond which depth is too smooth [pixels]; rendered ones have 0 to 4.
# Standard deviation of the depth near a step, as a fraction of the step: an even mixture of both sides.
MIXED = 0.3


def filled(depth: np.ndarray) -> np.ndarray:
    """Fill gaps in a depth image with the nearest measurement [m], shape [H, W]."""
    nearest: Any = ndimage.distance_transform_edt(depth <= 0, return_distances=False, return_indices=True)
    return depth[tuple(nearest)]


def edge_width(depth: np.ndarray) -> float:
    """Return the median width of steps in depth, from 10 to 90 % of the step [pixels].

    Args:
        depth: [m], shape [H, W]; 0: not measured.

    Returns:
        ``SHARP`` or more; ``SHARP`` if there are too few steps.
    """
    if not (depth > 0).any():
        return SHARP
    whole = filled(depth)
    widths = np.concatenate([_step_widths(whole), _step_widths(np.ascontiguousarray(whole.T))])
    return float(max(SHARP, np.median(widths))) if len(widths) >= LEAST_STEPS else SHARP


def _step_widths(depth: np.ndarray) -> np.ndarray:
    """Return the widths of at most several hundred steps along the rows [pixels]."""
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
    """Return the standard deviation of each pixel's depth [m], shape [H, W]: sensor noise, and near steps the
    mixture of both sides.

    Args:
        depth: [m], shape [H, W]; 0: not measured.
        width: width of steps [pixels], see ``edge_width``.
    """
    noise = depth_noise(depth)
    if width <= SHARP:
        return noise
    whole, size = filled(depth), 2 * round(0.5 * width) + 1
    step = ndimage.maximum_filter(whole, size) - ndimage.minimum_filter(whole, size)
    # Differences as small as the noise are no steps.
    return np.hypot(noise, MIXED * np.maximum(step - noise, 0.0))


# Levels of each channel in a color histogram: fine enough for shades of blue, coarse enough for a few
# hundred samples.
LEVELS = 12
UNKNOWN = 0.03  # Fraction of a class's colors that is not sampled: shadows, highlights, other things.
# Distance from the hand's outline at which a pixel is skin or not with equal odds, and width of the
# transition [m]: hands are located to 4 to 7 pixels, about 5 mm.
SKIN_EDGE = (0.004, 0.005)
HEIGHTS = 0.08  # Range of heights over which the object's density is uniform [m].
# Bound of the log-likelihood of depth and position, so that clear colors outweigh them.
FARTHEST_OUT = 8.0
# Standard deviation between the colors of mesh and image: logarithms of red and blue over green. Light and
# white balance shift them by some tenths.
TONE = 0.12
DARKEST = 8.0  # Added to colors, 0 to 255, before the logarithm, because dark colors have no clear tone.
# Fraction of a class's colors that differ from its samples in brightness only, such as shadows of the hand.
SHADED = 0.2
# Fraction of objects with the color of the hand, and with the color of the table; limits how much colors say
# against the object.
ALIKE = 0.1
# Largest difference between skin samples and their usual tone, in ``TONE``; others are in front of the hand.
SKIN_TONES = 2.0
TONE_BINS = 15  # Bins of each tone, from -1.5 to 1.5.
ROUNDS = 2  # Number of times that the object's colors are learned; more changed nothing.
LEAST_SAMPLES = 25  # Smallest number of pixels from which the object's colors are learned.
NEVER = -16.0  # Log-odds of a pixel that cannot show the object.
SMOOTHING = 1.2  # Standard deviation over which neighboring pixels share their evidence [pixels].
# Color at the center of each histogram cell, shape [LEVELS^3, 3].
_CELL_COLORS = (np.stack(np.unravel_index(np.arange(LEVELS**3), (LEVELS,) * 3), axis=-1) + 0.5) * (
    256.0 / LEVELS
)


@dataclass(frozen=True, eq=False)
class PixelClasses:
    """Probability of each class for every pixel; they sum to 1; shape [H, W] each."""

    obj: np.ndarray
    """Object, or another thing within reach of the hand."""
    skin: np.ndarray
    """Hand and forearm."""
    background: np.ndarray
    """Table, and everything out of reach."""


@dataclass(frozen=True, eq=False)
class PixelEvidence:
    """Evidence for each pixel besides its color, shape [H, W] each."""

    prior: np.ndarray
    """Log-odds that it shows the object, from hints and the reach of the fingertips; ``NEVER`` or less if it
    cannot."""
    samples: np.ndarray
    """Whether it shows the object according to a hint, bool."""
    height: np.ndarray
    """Height above the table [m]; NaN if unknown."""
    spread: np.ndarray
    """Standard deviation of the depth [m]."""
    skin_distance: np.ndarray
    """Distance from the hand's outline, negative inside [m at the hand's depth]; infinite without a hand."""
    sleeve: np.ndarray
    """Whether it is nearer to the forearm and its sleeve than to the hand, bool."""
    palm: np.ndarray
    """Whether it certainly shows the hand, bool."""
    ground: np.ndarray
    """Whether it certainly shows the background, bool."""


def classify(
    capture: Capture, evidence: PixelEvidence, mesh_colors: np.ndarray | None = None
) -> PixelClasses:
    """Combine color, depth and position.

    Args:
        mesh_colors: RGB of the object's surface, 0 to 1, shape [M, 3]; None if it has no colors.
    """
    color = ndimage.gaussian_filter(capture.color.astype(np.float32), (SMOOTHING / 2, SMOOTHING / 2, 0))
    index = color_cells(color)
    ground = table_of_colors(index[evidence.ground], SHADED)[index]
    palm = index[evidence.palm]
    skin = table_of_colors(_alike(palm) if len(palm) else palm, SHADED)[index]
    # Any color, including those of hand and table.
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
    """Return the histogram cell of each color, shape [...] int. color: RGB, 0 to 255, shape [..., 3]."""
    cell = np.minimum((color * (LEVELS / 256.0)).astype(np.int64), LEVELS - 1)
    return (cell[..., 0] * LEVELS + cell[..., 1]) * LEVELS + cell[..., 2]


def table_of_colors(samples: np.ndarray, brightness: float = 0.0) -> np.ndarray:
    """Return the probability of each color, shape [LEVELS^3]; uniform for fewer than 20 samples.

    Args:
        samples: color cells of pixels, shape [N] int.
        brightness: fraction of the colors that have the tone of the samples in any brightness.
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
    """Return log(red / green) and log(blue / green), shape [..., 2]. color: RGB, 0 to 255, shape [..., 3]."""
    return np.log(color[..., [0, 2]] + DARKEST) - np.log(color[..., 1:2] + DARKEST)


def _alike(samples: np.ndarray) -> np.ndarray:
    """Select the color cells of usual tone; other pixels show something in front of the hand."""
    tones = tone(_CELL_COLORS)[samples]
    some = tones[:: max(1, len(tones) // 300)]
    apart = np.linalg.norm(some[:, None] - some, axis=-1)
    usual = some[np.exp(-0.5 * (apart / TONE) ** 2).sum(axis=1).argmax()]
    return samples[np.linalg.norm(tones - usual, axis=1) < SKIN_TONES * TONE]


def _mesh_likelihood(color: np.ndarray, mesh_colors: np.ndarray) -> np.ndarray:
    """Return the likelihood of each pixel's tone for the mesh, relative to a uniform one, shape [H, W]."""
    some = mesh_colors[:: max(1, len(mesh_colors) // 40)] * 255.0
    tones, known = tone(color), tone(some)
    near = np.zeros(color.shape[:2])
    for value in known:
        near += np.exp(-0.5 * np.square((tones - value) / TONE).sum(axis=-1))
    # Tones lie between about -1 and 1: a Gaussian density relative to a uniform one of 1/4.
    return near / len(known) * 4.0 / (2 * np.pi * TONE**2)


def _tone_bins() -> tuple[np.ndarray, np.ndarray]:
    """Return the tone bin of each color cell, shape [LEVELS^3] int, and the number of cells in each bin."""
    bins = np.clip(((tone(_CELL_COLORS) / 3.0 + 0.5) * TONE_BINS).astype(int), 0, TONE_BINS - 1)
    flat = bins[:, 0] * TONE_BINS + bins[:, 1]
    return flat, np.bincount(flat, minlength=TONE_BINS**2).astype(float)


_TONE_OF_CELL, _CELLS_OF_TONE = _tone_bins()


def hand_in_image(capture: Capture, joints: np.ndarray) -> np.ndarray:
    """Return each pixel's distance from a hand's outline in the image, negative inside [m at the hand's
    depth], shape [H, W]. joints: [m], camera frame, shape [21, 3]."""
    k = capture.intrinsics
    depth = float(np.median(joints[:, 2]))
    # Hand and pixels are projected to the plane at the hand's depth.
    ends = (k.project(end) for end in SURE_SKIN.ends(joints))
    first, last = (k.deproject(end, np.full(len(end), depth)) for end in ends)
    every = k.rays()[::2, ::2]
    best = capsule_distances(depth * every.reshape(-1, 3), first, last, SURE_SKIN.radius)
    best = best.reshape(every.shape[:2])
    return best.repeat(2, axis=0).repeat(2, axis=1)[: k.height, : k.width]


def palm_pixels(capture: Capture, joints: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Return the pixels that certainly show the hand, bool, shape [H, W]: near its bones in the image, and as
    far behind or before the bones as most of these pixels, so that things in front of the hand do not count.

    Args:
        joints: [m], camera frame, shape [21, 3].
        outline: distance from the hand's outline, see ``hand_in_image``.
    """
    near = (outline < -0.003) & capture.measured
    rows, columns = np.nonzero(near)
    if len(rows) < 20:
        return near
    pixels = capture.intrinsics.project(joints)
    first, last = np.transpose(BONES)
    # Depth of a bone: that of its center, for the nearest bone.
    middles, depths = 0.5 * (pixels[first] + pixels[last]), 0.5 * (joints[first, 2] + joints[last, 2])
    apart = np.hypot(columns[:, None] - middles[:, 0], rows[:, None] - middles[:, 1])
    ahead = capture.depth[rows, columns] - depths[apart.argmin(axis=1)]
    usual = np.abs(ahead - np.median(ahead)) < 0.012
    result = np.zeros_like(near)
    result[rows[usual], columns[usual]] = True
    return result
