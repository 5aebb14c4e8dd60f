"""How probable it is that a pose is right, and what makes it uncertain."""

from __future__ import annotations

import numpy as np
import trimesh

from fungrasp.geometry.poses import transform_points
from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import ObjectEstimate, PerceptionWarning
from fungrasp.perception.hand.contact_evidence import HandSurroundings
from fungrasp.perception.object_pose.known_object import KnownObject
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.object_pose.scoring import PoseScores
from fungrasp.perception.scene.depth_edges import SMOOTHED

ACCEPT = 0.65
"""Poses of a lower score are not accepted. Cross-validated by scene, a third of them with a wrong mesh,
95 % of those above 0.6 and 97 % of those above 0.7 are right; of 36 right answers on measured images of one
block, 31 are above 0.6, 24 above 0.65 and 17 above 0.7."""

FEATURES = ("explained", "contradicted", "visible", "pixels")
"""Names of what the score is made of: explained, contradicted and visible part, logarithm of the pixels."""

WEIGHTS = np.array([-5.60, 6.33, -3.18, 1.85, 0.80])
"""Logistic regression on ``FEATURES`` (the first is the constant), ridge 0.03, fitted to the best answers on
42 rendered scenes (shapes of 5 to 14 cm, YCB and built-in objects) with the depth of stereo, structured-light
and time-of-flight cameras: with and without hints, masks 6 pixels too large or small, and a third of them
searched with the mesh of another object, counted twice. Right is ADD-S below 10 mm and a tenth of the
object's size, and no point of the surface, symmetries allowed for, farther than half that size from where it
is."""

PIXELS = (-1.0, 0.5)
"""Limits of the logarithm of the pixels, less 3: more than 3000 say nothing more, and less than 100 nothing
less."""

RIVALRY = 0.95
"""If a different pose has this part of the best one's quality or more, it may as well be the right one."""

RIVAL_DISTANCE = 0.01
"""A pose so far from another (ADD-S [m]) is a different answer."""

TURNED = 30.0
"""A pose turned by more than this [degrees] is a different answer, however well it fits."""

CLOSE = 0.1
"""Poses whose score is lower by less than this fit almost as well."""

LOOSE_MASK = 0.25
"""A mask with a larger part of other things is loose: 6 pixels too many around an object of 50 make 40 %,
true masks of the images looked at had up to 20 %."""

SAME = 0.001
"""Poses whose surfaces are nearer than this on average [m] look the same: a symmetry."""

COMPARED_POINTS = 300
"""Points of the object's surface by which poses are compared."""


def features(scores: PoseScores) -> np.ndarray:
    """What the score is made of, see ``FEATURES``; shape [H, 4]."""
    return np.stack(
        [
            scores.explained,
            np.minimum(scores.contradicted, 0.5),
            scores.visible,
            np.clip(np.log10(np.maximum(scores.pixels, 1.0)) - 3.0, *PIXELS),
        ],
        axis=-1,
    )


def confidence(scores: PoseScores) -> np.ndarray:
    """Probability that ADD-S is below 10 mm and the mesh is the right one, shape [H]."""
    return 1.0 / (1.0 + np.exp(-(features(scores) @ WEIGHTS[1:] + WEIGHTS[0])))


def rivals(known: KnownObject, poses: np.ndarray, quality: np.ndarray) -> np.ndarray:
    """Quality of the best different answer to each pose, 0 where there is none, shape [H].

    Args:
        known: the object.
        poses: shape [H, 7].
        quality: shape [H].
    """
    points = known.surface.samples[:300]
    result = np.zeros(len(poses))
    for i, pose in enumerate(poses):
        different = add_s(points, poses, pose) > RIVAL_DISTANCE
        result[i] = quality[different].max(initial=0.0)
    return result


def score_warnings(
    scores: PoseScores, rival: float, masked: bool, *, edge_width: float = 0.0, foreign: float = 0.0
) -> tuple[PerceptionWarning, ...]:
    """Why the first pose has a low score, the likeliest cause first.

    Args:
        scores: of one pose or more.
        rival: quality of the best different answer, see ``rivals``.
        masked: whether the object's mask was given.
        edge_width: how many pixels outlines are wide in the depth image.
        foreign: part of that mask's pixels that look like hand or background.
    """
    found = []
    if masked and foreign > LOOSE_MASK:
        found.append(PerceptionWarning.of("mask_loose", percent=100 * foreign))
    if edge_width > SMOOTHED:
        found.append(PerceptionWarning.of("depth_smoothed", pixels=edge_width))
    if scores.explained[0] < 0.7:
        what = "the mask" if masked else "what may be the object"
        found.append(
            PerceptionWarning.of("poorly_explained", percent=100 * float(scores.explained[0]), what=what)
        )
    if scores.contradicted[0] > 0.1:
        found.append(PerceptionWarning.of("contradicted"))
    if scores.contact[0] > 0.02:
        found.append(PerceptionWarning.of("far_from_fingertips", distance_mm=1000 * float(scores.contact[0])))
    if rival > RIVALRY * scores.quality[0]:
        found.append(PerceptionWarning.of("rival_pose"))
    if scores.pixels[0] < 500:
        found.append(PerceptionWarning.of("few_pixels", pixels=float(scores.pixels[0])))
    return tuple(found) or (PerceptionWarning.of("little_seen"),)


def ambiguity(model: ObjectModel, thing: ObjectEstimate) -> PerceptionWarning | None:
    """A warning if a different pose fits almost as well as the answer.

    The score is that of the surface's place. Of a nearly symmetric object it may be certain although it is
    not which way round the object is.
    """
    near = [pose for pose, score in thing.alternatives if score > thing.score - CLOSE]
    if not near:
        return None
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, COMPARED_POINTS, seed=0)[0])
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
