"""What an image says about a known object, made ready for searching and scoring poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.perception.io.capture import Capture, depth_noise
from fungrasp.perception.object_pose.object_template import ObjectTemplate
from fungrasp.perception.object_pose.scoring import PoseScorer, pose_scorer
from fungrasp.perception.object_pose.search import ObjectEvidence, free_space
from fungrasp.perception.scene.pixel_classes import SHARP
from fungrasp.perception.scene.segmentation import Segmentation, segment

LEAST_PIXELS = 80  # Fewer measured pixels of the object don't tell its pose.
# What a mask shows is not the mesh if its points are farther from their middle than this part of the mesh's
# size: those of a stick are 0.5 away at most, if its middle is seen.
TOO_LARGE = 0.6
# Part of a mask's pixels that may show something else far from the rest: masks drawn in labeling tools have
# holes and rims.
BACKGROUND = 0.5
COMPARED = 400  # So many of a mask's points are compared with each other to find where most of them are.
# Where depth is smoothed, a surface may be in front of it by so many standard deviations more.
SMOOTHED = 2.0
SURE = 0.9  # Pixels that show the background by this probability show no object, whatever their depth is.
WIDEST = 960  # Longer images [pixels] are thinned out: more pixels cost time and do not help.


@dataclass(frozen=True, eq=False)
class ObjectView:
    """What an image says about the object. ``view_of_object`` makes it."""

    known: ObjectTemplate
    """The object that is looked for."""
    capture: Capture
    """The image with its depth and intrinsics."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]``, camera frame, shape [4], if known."""
    joints: np.ndarray | None
    """Joints of the hand [m], camera frame, shape [21, 3]; None if not known."""
    support: np.ndarray
    """Confidence that a pixel shows a thing, not skin, table or room, 0 to 1, shape [H, W]."""
    masks: tuple[np.ndarray, ...]
    """Proposals for the object's pixels, bool, shape [H, W] each."""
    evidence: tuple[ObjectEvidence, ...]
    """What the object must agree with under each of ``masks``."""
    seen: Segmentation
    """What each pixel shows, and how certain its depth is."""
    given: np.ndarray | None = None
    """The mask as it was given, shape [H, W] bool; what is too far from the rest is not in ``capture``."""

    @property
    def foreign(self) -> float:
        """Part of the given mask's pixels that look like hand or background; 0 without a mask."""
        mask = self.capture.mask
        return 0.0 if mask is None else float((self.seen.classes.obj[mask] < 0.5).mean())

    def scorer(self, rays: int) -> PoseScorer:
        """Scores poses by about so many rays that meet a mask."""
        known, capture = self.known, self.capture
        return pose_scorer(known, capture, self.seen, self.masks, self.table, self.joints, rays)


def view_of_object(
    known: ObjectTemplate,
    capture: Capture,
    joints: np.ndarray | None,
    table: np.ndarray | None,
    rng: np.random.Generator,
) -> tuple[ObjectView | None, str]:
    """The image made ready; or why that can't be."""
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
        return None, f"what may be the object has only {max(counts, default=0)} pixels with depth"
    evidence = tuple(object_evidence(capture, mask, seen, table, rng) for mask in masks)
    return ObjectView(known, capture, table, joints, seen.support, masks, evidence, seen, given), ""


def cleaned_mask(capture: Capture, size: float, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """The mask without what is too far from most of it to be the same object, such as background.

    Args:
        capture: with a mask.
        size: longest distance within the object [m].

    Returns:
        the mask, shape [H, W] bool; how large a thing all of it would be [m].
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
    """What a mask says about the object.

    Args:
        mask: pixels that show the object, shape [H, W] bool.
        seen: what each pixel shows, and how certain its depth is.
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
