"""What speaks for and against a pose of the object and for its mesh: one record of numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy import ndimage

from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.perception.io.capture import depth_noise
from fungrasp.perception.object_pose.object_view import ObjectView
from fungrasp.perception.object_pose.scoring import HAND_SHIFTS, PoseScorer, color_evidence
from fungrasp.perception.object_pose.stretching import stretch_gain

STRETCH_RAYS = 250
"""About how many rays decide whether a stretched mesh fits better."""


@dataclass(frozen=True)
class PoseEvidence:
    """Numbers from the image about one pose of the mesh. NaN: not known."""

    told: float
    """1 where a mask says which pixels show the object, 0.5 for a box or a click, else 0."""
    explained: float
    """Part of the pixels that show the object whose depth the mesh explains."""
    trusted: float
    """The same where the depth is not smoothed over a step."""
    contradicted: float
    """Pixels in which the mesh would hide what was measured, or be hidden, as a part of the object's."""
    visible: float
    """Part of the mesh's silhouette beside skin that agrees with the measurement."""
    hidden: float
    """Part of the silhouette that skin hides."""
    outline: float
    """Overlap of the silhouette beside skin with the pixels that show the object, intersection over union."""
    pixels: float
    """Measured pixels that the pose explains."""
    residual: float
    """Distance of the measured points from the mesh, median, in what is expected there: the camera's noise
    and the roughness of the depth."""
    roughness_m: float
    """Difference of the depth from its neighborhood, median over the object [m]."""
    rival: float
    """Quality of the best different pose, as a part of this one's."""
    stretch_gain: float
    """Logarithm by how much better a stretched mesh explains the image."""
    stretch: float
    """By how much it is stretched: largest logarithm of a factor, whatever its sign."""
    color: float
    """Logarithm by how much likelier the colors seen are with the mesh's than with any; 0 without colors."""
    contact_m: float
    """Distance of the three nearest fingertips from the surface, mean [m]; 0 without a hand."""
    penetration_m: float
    """How deep the hand's bones are in the object before the hand is fitted to it, mean of the three deepest
    [m]; 0 without a hand."""
    below_m: float
    """How far the mesh reaches below the table [m]; 0 without a table."""
    edge_width: float
    """How many pixels outlines are wide in the depth image."""
    foreign: float
    """Part of the given mask's pixels that look like hand or background; 0 without a mask."""

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
    seen = view.known.rays.cast(pose[None], scorer.directions)[0]
    hits, mine = np.isfinite(seen), scorer.masks[owner]
    noise = depth_noise(scorer.depth)
    trust = mine * np.square(noise / scorer.spread)
    error = np.abs(np.where(hits, seen, 1e3) - scorer.depth)
    rough = _roughness(view, scorer)
    likeness = np.exp(-0.5 * np.square(error / (1.5 * np.hypot(noise, rough))))
    near = hits & (mine > 0.3) & (error < 0.03)
    shown = hits * (1.0 - scorer.skin)
    points = view.evidence[owner].points
    gain, factors = stretch_gain(
        view.scorer(STRETCH_RAYS), pose, owner, np.median(points, axis=0), rng
    )
    capture = view.capture
    told = 1.0 if capture.mask is not None else 0.5 if capture.box or capture.point else 0.0
    below = 0.0
    if view.table is not None:
        surface = transform_points(pose, view.known.surface.samples[:300])
        below = max(0.0, -float((surface @ view.table[:3] + view.table[3]).min()))
    return PoseEvidence(
        told=told,
        explained=float(scores.explained[0]),
        trusted=float(likeness @ trust / max(trust.sum(), 1e-6)),
        contradicted=float(scores.contradicted[0]),
        visible=float(scores.visible[0]),
        hidden=float(scores.hidden[0]),
        outline=float(np.minimum(shown, mine).sum() / max(np.maximum(shown, mine).sum(), 1e-6)),
        pixels=float(scores.pixels[0]),
        residual=float(np.median((error / np.hypot(noise, rough))[near])) if near.any() else 5.0,
        roughness_m=float(np.median(rough[mine > 0.3])) if (mine > 0.3).any() else 0.0,
        rival=rival / max(float(scores.quality[0]), 1e-6),
        stretch_gain=gain,
        stretch=float(np.abs(np.log(factors)).max()),
        color=color_evidence(view.known, capture, pose, view.support > 0.25),
        contact_m=float(scores.contact[0]),
        penetration_m=_penetration(view, pose),
        below_m=below,
        edge_width=view.seen.edge_width,
        foreign=view.foreign,
    )


def _roughness(view: ObjectView, scorer: PoseScorer) -> np.ndarray:
    """How far the depth at each ray differs from its neighborhood's, averaged nearby [m], shape [R]: gloss
    and grazing surfaces are rough."""
    depth = view.capture.depth
    v, u = scorer.pixels.T
    low = np.maximum([v.min() - 6, u.min() - 6], 0)
    part = depth[low[0] : v.max() + 7, low[1] : u.max() + 7].astype(np.float32)
    off = np.minimum(np.abs(part - ndimage.median_filter(part, 5)), 0.01)
    off[part <= 0] = 0.0
    measured = ndimage.uniform_filter((part > 0).astype(np.float32), 9)
    return (ndimage.uniform_filter(off, 9) / np.maximum(measured, 0.05))[v - low[0], u - low[1]]


def _penetration(view: ObjectView, pose: np.ndarray) -> float:
    """See ``PoseEvidence.penetration_m``, at the distance of the hand at which it is least."""
    if view.joints is None:
        return 0.0
    joints = view.joints
    least = np.inf
    for shift in HAND_SHIFTS:
        local = inverse_transform_points(pose, joints * (1.0 + shift / joints[:, 2].mean()))
        distance, _ = view.known.surface.distance.query(np.zeros(1, dtype=int), local[None])
        least = min(least, float(np.sort(np.maximum(-distance[0], 0.0))[-3:].mean()))
    return least
