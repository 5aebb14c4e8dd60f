"""Segmentation of the held object: pixels without table, arm and distant things.

Skin and object touch, so no single mask is reliable: several are proposed, and the fit of the known mesh
decides. A mask, box or click given by a person is used.
Camera frame: OpenCV [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial.distance import cdist

from fungrasp.grasps.human_hand import FINGERTIPS
from fungrasp.perception.hand.hand_capsules import SURE_SKIN, capsule_distances
from fungrasp.perception.io.capture import Box, Capture, Pixel
from fungrasp.perception.scene.pixel_classes import (
    NEVER,
    PixelClasses,
    PixelEvidence,
    classify,
    depth_spread,
    edge_width,
    hand_in_image,
    palm_pixels,
)
from fungrasp.perception.scene.table import plane_tolerance

FOREARM = (0.35, 0.045)  # Length and radius of forearm and sleeve [m].
MARGINS = (0.012, 0.004, 0.02)  # Distances from the skin within which pixels are left out, one per mask [m].
NEAR_HAND = 0.06  # Largest distance of a held thing from the skin [m].
FARTHEST = 3.0  # Largest depth of a held object [m].
GROUND_MARGIN = 60  # Distance from the object's pixels within which the table's colors are learned [pixels].
LEAST_GROUND = 500  # Smallest number of table pixels there; otherwise the whole image is used.
# Difference in depth [m], and at least 2 % of the depth, that separates neighboring pixels.
JUMP = 0.012


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Pixels that may show the object."""

    masks: tuple[np.ndarray, ...]
    """Proposals, best first, bool, shape [H, W] each; may be empty."""
    support: np.ndarray
    """Probability that a pixel shows the object or another thing within reach, 0 to 1, shape [H, W]."""
    classes: PixelClasses
    """Probability of each class."""
    spread: np.ndarray
    """Standard deviation of the depth [m], shape [H, W]; large where steps are smoothed."""
    edge_width: float
    """Width of steps in depth [pixels]."""


def _forearm_distance(points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return distances of points, shape [P, 3], from a straight forearm with a sleeve [m], shape [P]."""
    away = joints[0] - joints[[5, 9]].mean(axis=0)
    away = away / max(float(np.linalg.norm(away)), 1e-6)
    length, radius = FOREARM
    ends = joints[:1] + away * np.array([[radius], [length]])
    return capsule_distances(points, ends[:1], ends[1:], np.full((1, 2), radius))


def segment(
    capture: Capture,
    joints: np.ndarray | None,
    table: np.ndarray | None,
    size: float,
    mesh_colors: np.ndarray | None = None,
) -> Segmentation:
    """Propose masks of the object in the hand.

    Args:
        capture: image, maybe with a mask, box or point of the object; masks may be too large or too small by
            some pixels.
        joints: joints of the hand [m], camera frame, shape [21, 3]; None if unknown.
        table: plane ``[nx ny nz d]``: ``n . x + d`` is the height above it [m], shape [4]; None if unknown.
        size: longest distance between two points of the object [m].
        mesh_colors: RGB of the object's surface, 0 to 1, shape [M, 3]; None if it has no colors.
    """
    points = capture.points()
    prior, samples = hinted_odds(capture, size)
    hinted = capture.mask is not None or capture.box is not None or capture.point is not None
    measured = capture.measured & (capture.depth < FARTHEST)
    width = edge_width(capture.depth)
    spread = depth_spread(capture.depth, width)
    height = np.full(measured.shape, np.nan)
    if table is not None:
        height = np.where(capture.measured, points @ table[:3] + table[3], np.nan)
    if joints is not None and not hinted:
        reach = cdist(points.reshape(-1, 3), joints[FINGERTIPS]).min(axis=1).reshape(prior.shape)
        prior = np.where(measured & (reach < size + 0.03), prior, NEVER)
    near = measured & (prior > NEVER)
    candidate = near.copy() if table is None else near & ~(height <= plane_tolerance(capture.depth))
    rows, columns = np.nonzero(candidate)
    flat = points[rows, columns]
    hand, arm = np.full((2, *candidate.shape), np.inf)
    if joints is not None:
        hand[rows, columns] = capsule_distances(flat, *SURE_SKIN.ends(joints), SURE_SKIN.radius)
        arm[rows, columns] = _forearm_distance(flat, joints)
    prior = np.where(measured, prior, NEVER)
    outline, palm, ground = _hand_and_ground(capture, joints, prior > NEVER, samples, height)
    evidence = PixelEvidence(prior, samples, height, spread, outline, arm < hand, palm, ground)
    classes = classify(capture, evidence, mesh_colors)
    seen = (classes.obj > 0.5) & near
    if capture.mask is not None:
        masks = [seen, capture.mask & measured]
    elif capture.point is not None:
        masks = pointed_pieces(_pieces(seen, capture.depth), capture.point)
    else:
        masks = _groups(_pieces(seen, capture.depth), hand, joints is not None and not hinted)
    if capture.mask is None:
        # Colors may confuse skin and object: pixels clear of the hand are proposed as well.
        for margin in MARGINS if joints is not None else (0.0,):
            pieces = _pieces(candidate & (np.minimum(hand, arm) > margin), capture.depth)
            if capture.point is not None:
                masks.extend(pointed_pieces(pieces, capture.point))
            else:
                masks.extend(_groups(pieces, hand, joints is not None))
    return Segmentation(_different(masks), classes.obj * near, classes, spread, width)


def _hand_and_ground(
    capture: Capture, joints: np.ndarray | None, near: np.ndarray, samples: np.ndarray, height: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the distance from the hand's outline, and the pixels that certainly show hand and background,
    shape [H, W] each. near: pixels that may show the object, bool; others as in ``PixelEvidence``."""
    if joints is None:
        outline = np.full(near.shape, np.inf)
        palm = np.zeros(near.shape, dtype=bool)
    else:
        outline = hand_in_image(capture, joints)
        palm = palm_pixels(capture, joints, outline) & ~samples
    # The table begins right beside a box or a mask.
    around: Any = ndimage.maximum_filter(near, 2 * GROUND_MARGIN + 1)
    clear = capture.measured & ~near & (outline > 0.02)
    if np.isfinite(height).any():
        clear &= np.abs(height) < plane_tolerance(capture.depth)
    ground = clear & around
    return outline, palm, clear if ground.sum() < LEAST_GROUND else ground


def _groups(pieces: list[np.ndarray], hand: np.ndarray, held: bool) -> list[np.ndarray]:
    """Return masks: all pieces near the hand together, then single pieces."""
    if not pieces or not held:
        return pieces[:5]
    # Distances are infinite where they were not computed, far from the hand.
    distance = np.array([_near_end(hand[piece]) for piece in pieces])
    near = [piece for piece, d in zip(pieces, distance, strict=True) if d < NEAR_HAND]
    together = [np.logical_or.reduce(near)] if near else []
    likely = sorted(range(len(pieces)), key=lambda i: distance[i] - 0.05 * np.log(pieces[i].sum()))
    return [*together, *(pieces[i] for i in likely[:2])]


def _near_end(distance: np.ndarray) -> float:
    """Return the 2nd percentile of the finite distances [m]; infinite without any. distance: shape [P]."""
    known = distance[np.isfinite(distance)]
    return float(np.percentile(known, 2)) if len(known) else np.inf


def _pieces(mask: np.ndarray, depth: np.ndarray) -> list[np.ndarray]:
    """Return connected parts without jumps in depth, largest first, without small ones."""
    filled = np.where(mask, depth, 0.0)
    jump = np.maximum(JUMP, 0.02 * depth)
    broken = np.zeros(mask.shape, bool)
    for axis in (0, 1):
        step = np.abs(np.diff(filled, axis=axis))
        both = np.minimum(np.take(filled, range(1, mask.shape[axis]), axis), np.delete(filled, -1, axis)) > 0
        cut = both & (step > np.delete(jump, -1, axis))
        broken |= np.pad(cut, [(0, 1), (0, 0)] if axis == 0 else [(0, 0), (0, 1)])
    labeled: Any = ndimage.label(mask & ~broken)
    labels, count = labeled
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    least = max(60, int(0.02 * sizes.max(initial=0)))
    order = [int(i) for i in np.argsort(-sizes)[:8] if sizes[i] >= least]
    return [labels == i + 1 for i in order]


def _different(masks: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return the masks that differ from all earlier ones, at most six."""
    kept: list[np.ndarray] = []
    for mask in masks:
        overlaps = ((mask & other).sum() / max(int((mask | other).sum()), 1) for other in kept)
        if all(overlap < 0.92 for overlap in overlaps):
            kept.append(mask)
    return tuple(kept[:6])


# Log-odds deep inside a mask or at a click. Colors may outweigh them: masks have holes, and clicks miss.
MASK_SURE = 4.0
# Largest error of a mask's outline [pixels]. Pixels deeper inside, or in a thin mask more than half as
# deep as it is, show the object; pixels twice as far outside do not; between, color and depth decide.
MASK_WRONG = 6.0
CLICK = 3.0  # Radius around a click that shows the object [pixels].


def hinted_odds(capture: Capture, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the evidence of mask, box or point. size: longest distance within the object [m].

    Returns:
        log-odds that a pixel shows the object, ``NEVER`` where it cannot, shape [H, W]; pixels that certainly
        show it, shape [H, W] bool.
    """
    prior: np.ndarray = np.zeros(capture.depth.shape)
    samples: np.ndarray = np.zeros(capture.depth.shape, dtype=bool)
    mask: Any = capture.mask
    if mask is not None:
        inside: Any = ndimage.distance_transform_edt(mask)
        outside: Any = ndimage.distance_transform_edt(~mask)
        samples = inside >= min(MASK_WRONG, 0.5 * float(inside.max()))
        prior = np.where(samples, MASK_SURE, np.where(outside > 2 * MASK_WRONG, NEVER, 0.0))
    elif capture.box is not None:
        prior = np.where(_in_box(capture.box, prior.shape), 0.0, NEVER)
    if capture.point is not None:
        v, u = np.mgrid[: prior.shape[0], : prior.shape[1]]
        away = np.hypot(u - capture.point[0], v - capture.point[1])
        samples = away <= CLICK
        depths = capture.depth[(away <= 3 * CLICK) & capture.measured]
        depth = float(np.median(depths if len(depths) else capture.depth[capture.measured]))
        prior = np.where(samples, MASK_SURE, prior)
        prior = np.where(away < size * capture.intrinsics.fx / depth, prior, NEVER)
    return prior, samples


def pointed_pieces(pieces: list[np.ndarray], point: Pixel) -> list[np.ndarray]:
    """Return the piece nearest to the point, and this piece joined with others next to it."""
    if not pieces:
        return []
    away: list[float] = []
    for piece in pieces:
        rows, columns = np.nonzero(piece)
        away.append(float(np.hypot(columns - point[0], rows - point[1]).min()))
    order = np.argsort(away)
    first = pieces[order[0]]
    extent = 0.5 * np.sqrt(float(first.sum()))
    together = [pieces[i] for i in order if away[i] < away[order[0]] + extent]
    return [first, np.logical_or.reduce(together)] if len(together) > 1 else [first]


def _in_box(box: Box, shape: tuple[int, ...]) -> np.ndarray:
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    return (columns >= box[0]) & (columns <= box[2]) & (rows >= box[1]) & (rows <= box[3])
