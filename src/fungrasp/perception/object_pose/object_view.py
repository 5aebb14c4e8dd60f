"""An image prepared for the search and the scores of a known object's poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.perception.io.capture import Capture, depth_noise
from fungrasp.perception.object_pose.object_template import ObjectTemplate
from fungrasp.perception.object_pose.scoring import PoseScorer, pose_scorer
from fungrasp.perception.object_pose.search import ObjectEvidence, free_space
from fungrasp.perception.scene.pixel_classes import SHARP
from fungrasp.perception.scene.segmentation import Segmentation, segment

LEAST_PIXELS = 80  # Smallest number of measured pixels from which a pose is estimated.
# Largest distance of a mask's points from their center, as a fraction of the mesh's size; 0.5 for a stick.
TOO_LARGE = 0.6
# Largest fraction of a mask's pixels far from the rest: masks from labeling tools have holes and rims.
BACKGROUND = 0.5
COMPARED = 400  # Number of a mask's points that are compared with each other to find the densest ones.
# Standard deviations by which a surface may be farther in front of smoothed depth.
SMOOTHED = 2.0
SURE = 0.9  # Probability of background from which a pixel shows no object, whatever its depth is.
WIDEST = 960  # Largest side of the images used [pixels]: more pixels cost time and do not help.


@dataclass(frozen=True, eq=False)
class ObjectView:
    """An image prepared for a known object by ``view_of_object``."""

    known: ObjectTemplate
    """Known object."""
    capture: Capture
    """Color, depth and intrinsics."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]``, camera frame, shape [4], if known."""
    joints: np.ndarray | None
    """Joints of the hand [m], camera frame, shape [21, 3]; None if unknown."""
    support: np.ndarray
    """Probability that a pixel shows the object or another thing within reach, 0 to 1, shape [H, W]."""
    masks: tuple[np.ndarray, ...]
    """Proposals for the object's pixels, bool, shape [H, W] each."""
    evidence: tuple[ObjectEvidence, ...]
    """Evidence for the object's pose under each of ``masks``."""
    seen: Segmentation
    """Segmentation, with the standard deviation of the depth."""
    given: np.ndarray | None = None
    """Given mask, shape [H, W] bool; ``capture`` has it without pixels far from the rest."""

    @property
    def foreign(self) -> float:
        """Fraction of the mask's pixels that look like hand or background; 0 without a mask."""
        mask = self.capture.mask
        return 0.0 if mask is None else float((self.seen.classes.obj[mask] < 0.5).mean())

    def scorer(self, rays: int) -> PoseScorer:
        """Return a scorer of poses. rays: about how many rays meet a mask."""
        known, capture = self.known, self.capture
        return pose_scorer(known, capture, self.seen, self.masks, self.table, self.joints, rays)


def view_of_object(
    known: ObjectTemplate,
    capture: Capture,
    joints: np.ndarray | None,
    table: np.ndarray | None,
    rng: np.random.Generator,
) -> tuple[ObjectView | None, str]:
    """Prepare an image. Return the view, or None and the reason why that is impossible."""
    given = capture.mask
    if capture.mask is not None:
        pixels = int((capture.mask & capture.measured).sum())
        if pixels < LEAST_PIXELS:
            return None, f"the mask has only {pixels} pixels with depth"
        mask, extent = cleaned_mask(capture, known.size, rng)
        if (mask & capture.measured).sum() < (1.0 - BACKGROUND) * pixels:
            inverted = given is not None and given.mean() > 0.5
            return None, (
                f"the mask shows something {extent:.3f} m large, but the mesh is {known.size:.3f} m: "
                + ("is the mask inverted?" if inverted else "wrong mesh, mask or unit?")
            )
        capture = capture.with_object(mask=mask)
    seen = segment(capture, joints, table, known.size, known.colors)
    counts = [int((mask & capture.measured).sum()) for mask in seen.masks]
    masks = tuple(mask for mask, count in zip(seen.masks, counts, strict=True) if count >= LEAST_PIXELS)
    if not masks:
        return None, f"the probable object has only {max(counts, default=0)} pixels with depth"
    evidence = tuple(object_evidence(capture, mask, seen, table, rng) for mask in masks)
    return ObjectView(known, capture, table, joints, seen.support, masks, evidence, seen, given), ""


def cleaned_mask(capture: Capture, size: float, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Remove pixels from the mask that are too far from most others, such as background.

    Args:
        capture: capture with a mask.
        size: longest distance within the object [m].

    Returns:
        mask, shape [H, W] bool; size of the thing that the given mask shows [m].
    """
    mask = capture.mask
    assert mask is not None
    rows, columns = np.nonzero(mask & capture.measured)
    points = capture.intrinsics.deproject(np.stack([columns, rows], axis=-1), capture.depth[rows, columns])
    some = points[rng.permutation(len(points))[:COMPARED]]
    apart = np.linalg.norm(some[:, None] - some, axis=-1)
    crowded = apart[(apart < 0.5 * size).sum(axis=1).argmax()]
    middle = np.median(some[crowded < 0.5 * size], axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    cleaned = mask.copy()
    far = away > TOO_LARGE * size
    cleaned[rows[far], columns[far]] = False
    return cleaned, 2 * float(np.percentile(away, 90))


def object_evidence(
    capture: Capture, mask: np.ndarray, seen: Segmentation, table: np.ndarray | None, rng: np.random.Generator
) -> ObjectEvidence:
    """Return the evidence for the object's pose under a mask.

    Args:
        mask: pixels that show the object, shape [H, W] bool.
        seen: segmentation, with the standard deviation of the depth.
        table: plane ``[nx ny nz d]``, camera frame, or None.
    """
    shown = mask & capture.measured
    rows, columns = np.nonzero(shown)
    some = rng.permutation(len(rows))[:3000]
    rows, columns = rows[some], columns[some]
    points = capture.intrinsics.deproject(np.stack([columns, rows], axis=-1), capture.depth[rows, columns])
    noise = depth_noise(capture.depth)
    spread = seen.spread[rows, columns] / noise[rows, columns]
    uncertain = SMOOTHED * (seen.spread - noise)
    background = seen.classes.background > SURE if seen.edge_width > SHARP else None
    free = free_space(
        capture.depth, capture.intrinsics, mask, table, uncertain=uncertain, background=background
    )
    return ObjectEvidence(points, free, np.maximum(spread, 1.0))
