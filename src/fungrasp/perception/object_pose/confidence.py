"""How probable it is that a pose and its mesh are right, and what it might be confused with."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import transform_points
from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import ObjectEstimate, PerceptionWarning
from fungrasp.perception.hand.contact_evidence import HandSurroundings
from fungrasp.perception.object_pose.evidence import PoseEvidence
from fungrasp.perception.object_pose.known_object import KnownObject, known_object
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.object_pose.verdict_weights import OBJECT_WEIGHTS, Logistic
from fungrasp.perception.scene.depth_edges import SHARP

ACCEPT = 0.955
"""Answers of a lower probability are not accepted: the least at which no more than 1 % of wrong
meshes were, cross-validated over the captures of the fit."""

SMOOTHED_AGREES = 0.25
"""Where depth is smoothed right answers agree less: power of the outlines' width by which agreement counts
more. Of 0, 0.25, 0.5 and 1 the one with the least cross-validated loss."""

UNSEEN_LARGER, UNSEEN_OFF = 0.8, 2.8
"""What is taken where too little of the outline is seen [pixels]: twice the medians of right answers, so that
it speaks little for or against."""

PIECE = 10.0
"""Pieces of so few pixels count by their size, larger ones by its logarithm."""

RIVAL_DISTANCE = 0.01
"""A pose so far from another (ADD-S [m]) is a different answer."""

TURNED = 30.0
"""A pose turned by more than this [degrees] is a different answer, however well it fits."""

CLOSE = 0.1
"""Poses whose score is lower by less than this fit almost as well."""

SAME = 0.001
"""Poses whose surfaces are nearer than this on average [m] look the same: a symmetry."""

COMPARED_POINTS = 300
"""Points of the object's surface by which poses are compared."""


def features(evidence: PoseEvidence) -> dict[str, float]:
    """What the probability is made of: numbers of which more is always better, or always worse, within
    limits beyond which they say nothing more. By the names of ``OBJECT_WEIGHTS``."""
    e = evidence
    # Too small a mesh explains little of what is seen, of too large a one little is seen.
    agreement = min(e.explained, e.visible)
    allowed = float(np.clip(e.edge_width / SHARP, 1.0, 5.0)) ** SMOOTHED_AGREES
    return {
        "agreement": float(-np.log(np.clip(1.0 - agreement, 0.02, 1.0))) * allowed,
        "larger": UNSEEN_LARGER if np.isnan(e.larger) else abs(e.larger),
        "off": UNSEEN_OFF if np.isnan(e.off) else e.off,
        "left_over": float(np.log(e.left_over + 0.01)),
        "mask_piece": float(np.log1p(e.mask_piece / PIECE)),
        "told": float(e.told == 1.0),
        "other_size": float(np.clip(e.other_size, -0.6, 0.4)),
        "other_side": float(np.clip(e.other_side, -0.3, 0.3)),
        "rival": float(np.clip(5.0 * (e.rival - 0.8), 0.0, 1.0)),
    }


def confidence(evidence: PoseEvidence, weights: Logistic = OBJECT_WEIGHTS) -> float:
    """Probability that ADD-S is below 10 mm and the mesh is the right one."""
    return weights.probability(features(evidence))


def best_rival(known: KnownObject, poses: np.ndarray, quality: np.ndarray) -> float:
    """Quality of the best answer that is another than the first, 0 where there is none.

    Args:
        known: the object.
        poses: shape [H, 7].
        quality: shape [H].
    """
    different = add_s(known.surface.samples[:300], poses, poses[0]) > RIVAL_DISTANCE
    return float(quality[different].max(initial=0.0))


def ambiguity(model: ObjectModel, thing: ObjectEstimate) -> PerceptionWarning | None:
    """A warning if a different pose fits almost as well as the answer.

    The score is that of the surface's place. Of a nearly symmetric object it may be certain although it is
    not which way round the object is.
    """
    near = [pose for pose, score in thing.alternatives if score > thing.score - CLOSE]
    if not near:
        return None
    points = known_object(model).surface.samples[:COMPARED_POINTS]
    answer = HandSurroundings(model.signed_distance, thing.pose_camera_object)
    apart = np.array(
        [np.abs(answer.object_distance(transform_points(pose, points))[0]).mean() for pose in near]
    )
    turned = np.degrees(rotation_error(np.stack(near), thing.pose_camera_object))
    others = np.flatnonzero(((turned > TURNED) & (apart > SAME)) | (apart > RIVAL_DISTANCE))
    if not len(others):
        return None
    # They come in the order of their scores.
    distance_mm, turn_deg = 1000 * float(apart[others[0]]), float(turned[others[0]])
    if distance_mm > 1000 * RIVAL_DISTANCE:
        how = f"turned by {turn_deg:.0f} degrees" if turn_deg > TURNED else "elsewhere"
        return PerceptionWarning.of("object_elsewhere", how=how, distance_mm=distance_mm)
    return PerceptionWarning.of("object_orientation", turn_deg=turn_deg, distance_mm=distance_mm)
