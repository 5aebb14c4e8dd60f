"""What speaks for and against a pose of the object and for its mesh: one record of numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.geometry.poses import transform_points
from fungrasp.perception.object_pose.object_view import ObjectView
from fungrasp.perception.object_pose.scoring import PoseScorer
from fungrasp.perception.object_pose.stretching import other_sizes

SIZE_RAYS = 170
"""About how many rays decide whether another size of the mesh fits as well."""

SILHOUETTE_RAYS = 20_000
"""At most about so many rays draw the silhouette."""

BESIDE = 1.0
"""A pixel so near to the silhouette is covered by it [pixels]: outlines are no sharper."""


@dataclass(frozen=True)
class PoseEvidence:
    """Numbers from the image about one pose of the mesh. NaN: not known."""

    told: float
    """1 where a mask says which pixels show the object, 0.5 for a box or a click, else 0."""
    explained: float
    """Part of the pixels that show the object whose depth the mesh explains."""
    visible: float
    """Part of the mesh's silhouette beside skin that agrees with the measurement."""
    hidden: float
    """Part of the silhouette that skin hides."""
    pixels: float
    """Measured pixels that the pose explains."""
    rival: float
    """Quality of the best different pose, as a part of this one's."""
    other_size: float
    """How well another size of the mesh explains the image, see ``OtherSizes.whole``."""
    other_side: float
    """The same of another length of any side."""
    longer: float
    """The same of the longest side longer about either end."""
    colored: float
    """1 where the mesh has colors, else 0."""
    edge_width: float
    """How many pixels outlines are wide in the depth image."""
    foreign: float
    """Part of the given mask's pixels that look like hand or background; 0 without a mask."""
    covered: float
    """Part of the pixels that show the object which the mesh's silhouette covers, whatever their depth."""
    outside: float
    """Mean distance of the given mask's pixels from that silhouette, 0 inside it, as a part of the mesh's
    size; 0 without a mask."""

    def as_dict(self) -> dict[str, float]:
        """By name."""
        return {one.name: float(getattr(self, one.name)) for one in fields(self)}


def pose_evidence(
    view: ObjectView, scorer: PoseScorer, pose: np.ndarray, owner: int, rival: float, rng: np.random.Generator
) -> PoseEvidence:
    """The record of one pose.

    Args:
        view: the image.
        scorer: with many rays.
        pose: object in the camera frame, shape [7].
        owner: the mask that it was fitted to.
        rival: quality of the best different pose.
        rng: of the tries of other sizes.
    """
    scores = scorer(pose[None], np.array([owner]))
    points = view.evidence[owner].points
    sizes = other_sizes(view.scorer(SIZE_RAYS), pose, owner, np.median(points, axis=0), rng)
    capture = view.capture
    covered, outside = silhouette_cover(view, pose, owner)
    told = 1.0 if capture.mask is not None else 0.5 if capture.box or capture.point else 0.0
    return PoseEvidence(
        told=told,
        explained=float(scores.explained[0]),
        visible=float(scores.visible[0]),
        hidden=float(scores.hidden[0]),
        pixels=float(scores.pixels[0]),
        rival=rival / max(float(scores.quality[0]), 1e-6),
        other_size=sizes.whole,
        other_side=sizes.side,
        longer=sizes.longer,
        colored=float(view.known.colors is not None),
        edge_width=view.seen.edge_width,
        foreign=view.foreign,
        covered=covered,
        outside=outside,
    )


def silhouette_cover(view: ObjectView, pose: np.ndarray, owner: int) -> tuple[float, float]:
    """``covered`` and ``outside`` of ``PoseEvidence``: a mesh that is too short leaves a piece over, be it
    without depth. pose: object in the camera frame, shape [7]; owner: the mask that it was fitted to."""
    capture, lens = view.capture, view.capture.intrinsics
    own, mask = view.masks[owner] & capture.measured, capture.mask
    rows, columns = np.nonzero(own if mask is None else own | mask)
    drawn = lens.project(transform_points(pose, view.known.surface.samples))
    low = np.floor(np.minimum(drawn.min(axis=0), [columns.min(), rows.min()])).astype(int) - 2
    high = np.ceil(np.maximum(drawn.max(axis=0), [columns.max(), rows.max()])).astype(int) + 3
    low, high = np.maximum(low, 0), np.minimum(high, [lens.width, lens.height])
    step = max(1, int(np.sqrt(np.prod(high - low) / SILHOUETTE_RAYS)))
    part = (slice(low[1], high[1], step), slice(low[0], high[0], step))
    v, u = np.mgrid[part]
    rays = lens.deproject(np.stack([u.ravel(), v.ravel()], axis=-1), np.ones(u.size))
    shown = np.isfinite(view.known.rays.cast(pose[None], rays)).reshape(u.shape)
    if not shown.any():
        return 0.0, 0.0 if mask is None else 1.0
    away: Any = ndimage.distance_transform_edt(~shown)
    beside = step * away
    weight = np.where(own[part], view.support[part], 0.0)
    covered = 1.0 - float(weight[beside > BESIDE].sum()) / max(float(weight.sum()), 1e-6)
    if mask is None:
        return covered, 0.0
    meters = float(np.median(capture.depth[own])) / lens.fx
    return covered, meters * float(beside[mask[part]].mean()) / view.known.size
