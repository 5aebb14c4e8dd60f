"""Which pixels may show the object that the hand holds: the table, the arm and far things taken away.

No single answer is safe, as skin and object touch: several masks are proposed, and the fit of the known mesh
decides. What a person says about the object's place, by a mask, a box or a click, counts.
Camera frame: OpenCV [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial.distance import cdist

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
MARGINS = (0.012, 0.004, 0.02)  # Pixels nearer to the skin [m] are left out of such masks; several are tried.
TIPS = (4, 8, 12, 16, 20)  # The fingertips among the 21 joints.
NEAR_HAND = 0.06  # A thing this near to the hand's skin [m] may be what it holds.
FARTHEST = 3.0  # Nobody holds an object farther away [m].
GROUND_MARGIN = 60  # The table's colors are learned within so many pixels of where the object may be.
LEAST_GROUND = 500  # If fewer pixels show the table there, it is looked at everywhere.
# Neighboring pixels whose depth differs by more than this [m], and by more than 2 % of it, do not belong
# together.
JUMP = 0.012


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Where the object may be."""

    masks: tuple[np.ndarray, ...]
    """Different proposals, each bool, shape [H, W]; best guess first; none if nothing is there."""
    support: np.ndarray
    """Confidence that a pixel shows the object or another thing, not skin, table or room: 0 to 1, shape
    [H, W]."""
    classes: PixelClasses
    """Probability of each class."""
    spread: np.ndarray
    """Standard deviation of the depth [m], shape [H, W]; large where steps are smoothed."""
    edge_width: float
    """How many pixels steps in depth are mixed over."""


def _forearm_distance(points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Distance of points, shape [P, 3], from a sleeved forearm that goes straight on [m], shape [P]."""
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
    """Propose masks for the object in the hand.

    Args:
        capture: its mask, box or point, if it has one, says where the object is. Masks may be too large or
            too small by some pixels.
        joints: of the hand [m], camera frame, shape [21, 3], if known.
        table: plane ``[nx ny nz d]``, ``n . x + d`` the height above it [m], shape [4], if there is one.
        size: longest distance between two points of the object [m].
        mesh_colors: RGB of the object's surface, 0 to 1, shape [M, 3], if it has colors.
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
        reach = cdist(points.reshape(-1, 3), joints[list(TIPS)]).min(axis=1).reshape(prior.shape)
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
        # Colors may take skin for the object: what is clear of the hand is proposed as well.
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
    """Distance from the hand in the image, and which pixels surely show the hand and the background, shape
    [H, W]. near: whether a pixel may show the object, bool; the others as in ``PixelEvidence``."""
    if joints is None:
        outline = np.full(near.shape, np.inf)
        palm = np.zeros(near.shape, dtype=bool)
    else:
        outline = hand_in_image(capture, joints)
        palm = palm_pixels(capture, joints, outline) & ~samples
    # A box or mask is drawn round the object: the table begins right beside it.
    around: Any = ndimage.maximum_filter(near, 2 * GROUND_MARGIN + 1)
    clear = capture.measured & ~near & (outline > 0.02)
    if np.isfinite(height).any():
        clear &= np.abs(height) < plane_tolerance(capture.depth)
    ground = clear & around
    return outline, palm, clear if ground.sum() < LEAST_GROUND else ground


def _groups(pieces: list[np.ndarray], hand: np.ndarray, held: bool) -> list[np.ndarray]:
    """Masks out of connected pieces: all those near the hand, and single ones."""
    if not pieces or not held:
        return pieces[:5]
    # Pixels that were not measured against the hand are far from it.
    distance = np.array([_near_end(hand[piece]) for piece in pieces])
    near = [piece for piece, d in zip(pieces, distance, strict=True) if d < NEAR_HAND]
    together = [np.logical_or.reduce(near)] if near else []
    likely = sorted(range(len(pieces)), key=lambda i: distance[i] - 0.05 * np.log(pieces[i].sum()))
    return [*together, *(pieces[i] for i in likely[:2])]


def _near_end(distance: np.ndarray) -> float:
    """The 2nd percentile of distances [m] that are known; infinite where none is. distance: shape [P]."""
    known = distance[np.isfinite(distance)]
    return float(np.percentile(known, 2)) if len(known) else np.inf


def _pieces(mask: np.ndarray, depth: np.ndarray) -> list[np.ndarray]:
    """Connected parts without jumps of depth, largest first, small ones left out."""
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
    """Masks that are not nearly the same as an earlier one, at most six."""
    kept: list[np.ndarray] = []
    for mask in masks:
        overlaps = ((mask & other).sum() / max(int((mask | other).sum()), 1) for other in kept)
        if all(overlap < 0.92 for overlap in overlaps):
            kept.append(mask)
    return tuple(kept[:6])


# Logarithm of the odds of what is deep in a mask, or clicked at: colors that say otherwise may still win, as
# masks have holes and clicks go beside.
MASK_SURE = 4.0
# Masks are wrong by up to 6 pixels: so deep inside, or as deep as a thin one goes, they say what shows the
# object; twice as far outside nothing is looked at; between, color and depth say where its outline is, as
# they do without a mask.
MASK_WRONG = 6.0
CLICK = 3.0  # Pixels so near to the one that was clicked at show the same.


def hinted_odds(capture: Capture, size: float) -> tuple[np.ndarray, np.ndarray]:
    """What mask, box or point say about each pixel. size: longest distance within the object [m].

    Returns:
        logarithm of the odds that it shows the object, ``NEVER`` outside a box, shape [H, W]; which pixels
        surely show it, shape [H, W] bool.
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
    """The piece in which the point is, or the nearest one; and that with the others next to it."""
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
