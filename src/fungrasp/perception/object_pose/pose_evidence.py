"""What speaks for a pose of the mesh, and what it may be confused with: another size of the mesh, another
pose.

Where another size of the mesh fits the image as well, it need not be the mesh of what is seen.
"""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.objects import ObjectModel
from fungrasp.perception.io.estimates import ObjectEstimate, PerceptionWarning, PoseEvidence
from fungrasp.perception.object_pose.object_template import ObjectTemplate, object_template
from fungrasp.perception.object_pose.object_view import ObjectView
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.object_pose.scoring import PoseScorer
from fungrasp.perception.object_pose.silhouette_edges import silhouette_edges

SIZE_RAYS = 170  # About how many rays decide whether another size of the mesh fits as well.
# Sizes that are tried of the whole mesh, and of each side alone.
WHOLE, SIDES = (0.67, 0.82, 1.22, 1.5), (0.75, 1.33)
# Poses that are tried of each size, one after the other; standard deviations of their shift [m] and turn
# [degrees].
SETTLED = ((8, 0.004, 4.0), (5, 0.002, 2.0), (5, 0.001, 1.0))
# A pose so far from another (ADD-S [m]), or turned by more than this [degrees], is a different answer,
# however well it fits.
RIVAL_DISTANCE, TURNED = 0.01, 30.0
CLOSE = 0.1  # Poses whose score is lower by less than this fit almost as well.
SAME = 0.001  # Poses whose surfaces are nearer than this on average [m] look the same: a symmetry.


def pose_evidence(
    view: ObjectView, scorer: PoseScorer, pose: np.ndarray, owner: int, rival: float, rng: np.random.Generator
) -> PoseEvidence:
    """The record of one pose.

    Args:
        pose: object in the camera frame, shape [7].
        owner: the mask that it was fitted to.
        rival: quality of the best different pose.
    """
    scores = scorer(pose[None], np.array([owner]))
    points = view.evidence[owner].points
    size, side = scale_ambiguity(view.scorer(SIZE_RAYS), pose, owner, np.median(points, axis=0), rng)
    capture = view.capture
    edges = silhouette_edges(view, pose, owner)
    hinted = 1.0 if capture.mask is not None else 0.5 if capture.box or capture.point else 0.0
    return PoseEvidence(
        hinted=hinted,
        explained=float(scores.explained[0]),
        visible=float(scores.visible[0]),
        hidden=float(scores.hidden[0]),
        pixels=float(scores.pixels[0]),
        rival=rival / max(float(scores.quality[0]), 1e-6),
        other_size=size,
        other_side=side,
        colored=float(view.known.colors is not None),
        edge_width=view.seen.edge_width,
        foreign=view.foreign,
        larger=edges.larger,
        off=edges.off,
        left_over=edges.left_over,
        mask_piece=edges.mask_piece,
    )


def scale_ambiguity(
    scorer: PoseScorer, pose: np.ndarray, owner: int, anchor: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    """How well other sizes of the mesh explain the image. Each is moved in the same ways about the same pose,
    so that none gains by chance. The whole mesh grows about what is seen of it, a side also about either of
    its ends: a mesh that is too short mostly lies at one end of the thing.

    Args:
        pose: object in the camera frame, shape [7].
        owner: the mask that it was fitted to.
        anchor: middle of what is seen of the object [m], camera frame, shape [3].

    Returns:
        Logarithms of the quality over the mesh's own, below 0 where it is worse: of the best other size of
        all of it, and of the best other length of any side. Near 0 the image does not say which size it is.
    """
    samples = scorer.known.surface.samples
    low, high = samples.min(axis=0), samples.max(axis=0)
    seen = np.clip(inverse_transform_points(pose, anchor[None])[0], low, high)
    sizes = [(np.ones(3), seen), *((np.full(3, size), seen) for size in WHOLE)]
    for axis in range(3):
        mine = np.arange(3) == axis
        for still in (low, seen, high):
            for size in SIDES:
                sizes.append((np.where(mine, size, 1.0), np.where(mine, still, seen)))
    stretch, still = (np.array(part) for part in zip(*sizes, strict=True))
    places, turns = transform_points(pose, still), np.repeat(pose[None, 3:], len(stretch), axis=0)
    quality, rows = np.zeros(len(stretch)), np.arange(len(stretch))
    for count, shift, turn in SETTLED:
        moves = rng.normal(size=(count, 6))
        moves[0] = 0.0
        near = places[:, None] + shift * moves[:, :3]
        steps = quaternion_from_rotation_vector(np.radians(turn) * moves[:, 3:])
        turned = quaternion_multiply(steps, turns[:, None])
        turned = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
        factors, middle = np.repeat(stretch, count, axis=0), np.repeat(still, count, axis=0)
        around = turned.reshape(-1, 4)
        poses = np.concatenate([near.reshape(-1, 3) - rotate(around, factors * middle), around], axis=1)
        tried = scorer(poses, np.full(len(poses), owner), factors).quality.reshape(near.shape[:2])
        best = tried.argmax(axis=1)
        places, turns, quality = near[rows, best], turned[rows, best], tried[rows, best]
    worth = np.log(np.maximum(quality, 1e-4) / max(quality[0], 1e-4))
    first = 1 + len(WHOLE)
    return float(worth[1:first].max()), float(worth[first:].max())


def best_rival(known: ObjectTemplate, poses: np.ndarray, quality: np.ndarray) -> float:
    """Quality of the best answer that is another than the first, 0 where there is none.

    Args:
        poses: shape [H, 7].
        quality: shape [H].
    """
    different = add_s(known.surface.samples[:300], poses, poses[0]) > RIVAL_DISTANCE
    return float(quality[different].max(initial=0.0))


def ambiguity(model: ObjectModel, obj: ObjectEstimate) -> PerceptionWarning | None:
    """A warning if a different pose fits almost as well as the answer.

    The score is that of the surface's place. Of a nearly symmetric object it may be certain although it is
    not which way round the object is.
    """
    near = [pose for pose, score in obj.alternatives if score > obj.score - CLOSE]
    if not near:
        return None
    surface = object_template(model).surface
    points, answer = surface.samples[:300], obj.pose_camera_object
    apart = np.array([surface.distances(transform_points(pose, points), answer).mean() for pose in near])
    turned = np.degrees(rotation_error(np.stack(near), obj.pose_camera_object))
    others = np.flatnonzero(((turned > TURNED) & (apart > SAME)) | (apart > RIVAL_DISTANCE))
    if not len(others):
        return None
    # They come in the order of their scores.
    distance_mm, turn_deg = 1000 * float(apart[others[0]]), float(turned[others[0]])
    if distance_mm > 1000 * RIVAL_DISTANCE:
        how = f"turned by {turn_deg:.0f} degrees" if turn_deg > TURNED else "elsewhere"
        return PerceptionWarning.of("object_elsewhere", how=how, distance_mm=distance_mm)
    return PerceptionWarning.of("object_orientation", turn_deg=turn_deg, distance_mm=distance_mm)
