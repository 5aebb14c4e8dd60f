"""One image made ready for judging and searching poses of a known object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.object_pose.icp import Evidence
from fungrasp.perception.object_pose.known_object import KnownObject
from fungrasp.perception.object_pose.scoring import Judge, make_judge
from fungrasp.perception.object_pose.search import gather
from fungrasp.perception.scene.segmentation import segment

LEAST_PIXELS = 80
"""Fewer measured pixels of the object don't tell its pose."""

TOO_LARGE = 1.25
"""What a mask shows is not the mesh if it is larger by this factor."""

WIDEST = 960
"""Longer images [pixels] are thinned out: more pixels cost time and do not help."""


@dataclass(frozen=True, eq=False)
class View:
    """What an image says about the object. ``make_view`` makes it."""

    known: KnownObject
    capture: Capture
    table: np.ndarray | None
    joints: np.ndarray | None
    support: np.ndarray
    masks: tuple[np.ndarray, ...]
    evidence: tuple[Evidence, ...]

    def judge(self, rays: int) -> Judge:
        known, capture = self.known, self.capture
        return make_judge(known, capture, self.support, self.masks, self.table, self.joints, rays)


def thinned(capture: Capture) -> Capture:
    """Every so many rows and columns, so that the longer side is at most ``WIDEST``."""
    k = capture.intrinsics
    step = -(-max(k.width, k.height) // WIDEST)
    if step == 1:
        return capture
    colour, depth = capture.colour[::step, ::step], capture.depth[::step, ::step]
    lens = Intrinsics(depth.shape[1], depth.shape[0], k.fx / step, k.fy / step, k.cx / step, k.cy / step)
    mask = None if capture.mask is None else capture.mask[::step, ::step]
    if mask is not None and not mask.any():
        return capture
    x0, y0, x1, y1 = np.array(capture.box or (0.0, 0.0, 1.0, 1.0)) / step
    box = None if capture.box is None else (float(x0), float(y0), float(x1), float(y1))
    return Capture(colour, depth, lens, mask, box)


def make_view(
    known: KnownObject,
    capture: Capture,
    joints: np.ndarray | None,
    table: np.ndarray | None,
    rng: np.random.Generator,
) -> tuple[View | None, str]:
    """The image made ready; or why that can't be."""
    if capture.mask is not None:
        masks: tuple[np.ndarray, ...] = (capture.mask,)
        support = capture.mask.astype(float)
    else:
        segmentation = segment(capture, joints, table, known.size)
        masks, support = segmentation.masks, segmentation.support
    counts = [int((mask & capture.measured).sum()) for mask in masks]
    masks = tuple(mask for mask, count in zip(masks, counts, strict=True) if count >= LEAST_PIXELS)
    if not masks:
        where = "the mask" if capture.mask is not None else "what may be the object"
        return None, f"{where} has only {max(counts, default=0)} pixels with depth"
    evidence = tuple(gather(capture, mask, table, rng) for mask in masks)
    if capture.mask is not None:
        low, high = np.percentile(evidence[0].points, [3, 97], axis=0)
        extent = float(np.linalg.norm(high - low))
        if extent > TOO_LARGE * known.size:
            return None, (
                f"the mask shows something {extent:.3f} m large, but the mesh is {known.size:.3f} m: "
                "wrong mesh, mask or unit?"
            )
    return View(known, capture, table, joints, support, masks, evidence), ""
