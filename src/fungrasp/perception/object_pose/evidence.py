"""What speaks for and against a pose of the object and for its mesh: one record of numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from fungrasp.perception.object_pose.object_view import ObjectView
from fungrasp.perception.object_pose.outline import outline_of
from fungrasp.perception.object_pose.scoring import PoseScorer
from fungrasp.perception.object_pose.stretching import other_sizes

SIZE_RAYS = 170
"""About how many rays decide whether another size of the mesh fits as well."""


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
    colored: float
    """1 where the mesh has colors, else 0."""
    edge_width: float
    """How many pixels outlines are wide in the depth image."""
    foreign: float
    """Part of the given mask's pixels that look like hand or background; 0 without a mask."""
    larger: float
    """How much larger the outline in the image is than the mesh's silhouette [pixels], see ``Outline``."""
    off: float
    """How far the one is from the other where it is most [pixels]."""
    left_over: float
    """How far what shows the object reaches beyond the silhouette, as a part of the mesh's size."""
    mask_piece: float
    """The largest piece of the given mask beyond the silhouette [pixels]."""

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
    outline = outline_of(view, pose, owner)
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
        colored=float(view.known.colors is not None),
        edge_width=view.seen.edge_width,
        foreign=view.foreign,
        larger=outline.larger,
        off=outline.off,
        left_over=outline.left_over,
        mask_piece=outline.mask_piece,
    )
