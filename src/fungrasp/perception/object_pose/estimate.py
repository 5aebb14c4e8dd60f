"""Pose estimation of a known mesh in a depth image, and scores of poses from other programs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.grasps.human_hand import FINGERTIPS
from fungrasp.objects import ObjectModel
from fungrasp.perception.acceptance import ACCEPT, SIZES, object_score
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, PoseEvidence
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.object_view import WIDEST, ObjectView, view_of_object
from fungrasp.perception.object_pose.pose_error import add_s
from fungrasp.perception.object_pose.pose_evidence import RIVAL_DISTANCE, best_rival, pose_evidence
from fungrasp.perception.object_pose.scoring import PoseScorer, PoseScores, color_agreement
from fungrasp.perception.object_pose.search import (
    FINE,
    PoseHypotheses,
    best_poses,
    polish_poses,
    refine_poses,
    search_poses,
    with_symmetries,
)
from fungrasp.perception.scene.pixel_classes import SHARP
from fungrasp.perception.scene.table import largest_plane

if TYPE_CHECKING:
    import trimesh

COLOR_WEIGHT = 0.15  # Bonus for full agreement of colors, as a fraction of the best quality.
POLISHED = 6  # Number of poses that are polished if depth is smoothed.
RAYS = 1000  # About how many rays of the final scores meet a mask.
ANSWERS = 5  # Largest number of alternatives.
ALLOWED = 0.25  # Smallest probability to show a thing of pixels whose colors are compared.


def estimate_object_pose(
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh,
    hand: HandEstimate | None = None,
    table: np.ndarray | None = None,
    *,
    seed: int = 0,
) -> ObjectEstimate:
    """Estimate the pose of a known object in a depth image.

    The mask of the capture shows the object. Without a mask, several are proposed from table, hand, box and
    point, and the fit decides. If the image does not support the result, ``accepted`` is False and there are
    warnings.

    Args:
        capture: image.
        mesh: object [m]; colors of a trimesh help to orient nearly symmetric objects.
        hand: hand that holds the object, if known.
        table: plane ``[nx ny nz d]``: ``n . x + d`` is the height of a point above it [m], camera frame,
            shape [4]; found in the image if None.
        seed: random seed.

    Raises:
        FungraspError: the mesh has no faces.
    """
    capture = capture.reduced(WIDEST)
    size = float(np.linalg.norm(np.ptp(np.asarray(mesh.vertices), axis=0))) if len(mesh.vertices) else 0.0
    joints = None if hand is None else hand.joints_camera
    if not SIZES[0] < size < SIZES[1]:
        unit = "; is it in millimeters?" if size >= SIZES[1] else ""
        return _nothing(
            capture,
            joints,
            PerceptionWarning.of("not_searched", problem=f"the mesh is {size:.4g} m large{unit}"),
        )
    known, rng = object_template(mesh), np.random.default_rng(seed)
    if table is None:
        table = largest_plane(capture, rng)
    view, problem = view_of_object(known, capture, joints, table, rng)
    if problem or view is None:
        return _nothing(capture, joints, PerceptionWarning.of("not_searched", problem=problem))
    found, scores, color = _answers(view, rng)
    order = np.argsort(-(scores.quality + COLOR_WEIGHT * scores.quality.max() * color))
    poses, scores = found.poses[order], scores.chosen(order)
    owner = int(found.owner[order[0]])
    rival = best_rival(known, poses, scores.quality)
    evidence = pose_evidence(view, view.scorer(RAYS), poses[0], owner, rival, rng)
    return _best(poses, scores, evidence)


def _best(poses: np.ndarray, scores: PoseScores, first: PoseEvidence) -> ObjectEstimate:
    """Return the estimate with the best pose and its alternatives.

    Args:
        poses: object in the camera frame, best first, shape [H, 7].
        scores: scores of the H poses.
        first: evidence for the first pose.
    """
    score = object_score(first)
    others = []
    for i in range(1, min(len(poses), ANSWERS + 1)):
        # Near-symmetric poses share most of their pixels, hence the square root of the relative quality.
        relative = float(scores.quality[i] / max(scores.quality[0], 1e-6))
        others.append((poses[i], score * min(relative, 1.0) ** 0.5))
    return ObjectEstimate(poses[0], score, score >= ACCEPT, tuple(others), evidence=first)


def _answers(view: ObjectView, rng: np.random.Generator) -> tuple[PoseHypotheses, PoseScores, np.ndarray]:
    """Return different poses, their scores, and the agreement of their colors."""
    few, many = view.scorer(250), view.scorer(RAYS)
    known, evidence = view.known, view.evidence
    found = search_poses(known, evidence, (few, many), rng)
    if len(known.symmetries):
        # Details that distinguish the sides may be hidden: all variants are kept, and colors may decide.
        found = refine_poses(
            known, evidence, with_symmetries(best_poses(found, known, many, 2), known), FINE[0]
        )
        found = refine_poses(known, evidence, best_poses(found, known, many, 24), FINE[1])
    if view.seen.edge_width > SHARP:
        polished = polish_poses(best_poses(found, known, many, POLISHED), known, few, rng)
        found = found.joined(polished)
    found = best_poses(found, known, many, 24)
    color = color_agreement(known, view.capture, found.poses, view.support > ALLOWED)
    return found, many(found.poses, found.owner), color


def _nothing(capture: Capture, joints: np.ndarray | None, why: PerceptionWarning) -> ObjectEstimate:
    """Return an estimate that is not accepted, at the center of the fingertips or of the mask."""
    if joints is not None:
        middle = joints[FINGERTIPS].mean(axis=0)
    else:
        shown = capture.measured if capture.mask is None else capture.mask & capture.measured
        points = capture.points()[shown if shown.any() else capture.measured]
        middle = np.median(points, axis=0)
    pose = np.concatenate([middle, [1.0, 0.0, 0.0, 0.0]])
    return ObjectEstimate(pose, 0.0, False, warnings=(why,))


def score_given_pose(
    obj: ObjectEstimate,
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh,
    hand: HandEstimate | None = None,
    table: np.ndarray | None = None,
    *,
    seed: int = 0,
    improve: bool = False,
) -> ObjectEstimate:
    """Score a pose from another program by the depth, like those of ``estimate_object_pose``.

    The pose is fitted to the depth. The best fit within 10 mm of it, or the pose itself, gives the score.

    Args:
        obj: pose from another program.
        capture: image.
        mesh: object [m], see ``estimate_object_pose``.
        hand: hand that holds the object, if known.
        table: plane ``[nx ny nz d]``, camera frame, shape [4]; None if unknown.
        seed: random seed.
        improve: whether to return the best fit instead of the pose itself.

    Returns:
        Estimate with the new score; its alternatives are the near-symmetric variants of the pose, each
        fitted. It is not accepted if the depth cannot be compared; a warning says why.

    Raises:
        FungraspError: the mesh has no faces.
    """
    known, rng = object_template(mesh), np.random.default_rng(seed)
    joints = None if hand is None else hand.joints_camera
    view, problem = view_of_object(known, capture.reduced(WIDEST), joints, table, rng)
    if view is None:
        warnings = (PerceptionWarning.of("not_comparable", problem=problem),)
        return replace(obj, score=0.0, accepted=False, alternatives=(), warnings=warnings, judged=True)
    pose, scorer = obj.pose_camera_object, view.scorer(RAYS)
    proposals = np.arange(len(view.masks))
    given = found = PoseHypotheses(np.repeat(pose[None], len(proposals), axis=0), proposals)
    for step in FINE:
        found = refine_poses(known, view.evidence, found, step)
    found = found.joined(given)
    poses, owners = found.poses, found.owner
    scores = scorer(poses, owners)
    near = add_s(known.surface.samples, poses, pose) < RIVAL_DISTANCE
    best = int(np.argmax(np.where(near, scores.quality, -1.0)))
    chosen = poses[best] if improve else pose
    first = PoseHypotheses(poses[best : best + 1], owners[best : best + 1])
    others = _turned(first, view, scorer)
    answers = first.joined(others)
    scores = scorer(answers.poses, answers.owner)
    evidence = pose_evidence(view, scorer, poses[best], int(owners[best]), 0.0, rng)
    return replace(_best(answers.poses, scores, evidence), pose_camera_object=chosen)


def _turned(first: PoseHypotheses, view: ObjectView, scorer: PoseScorer) -> PoseHypotheses:
    """Return the near-symmetric variants of a pose, fitted to the depth, best first: a program that gives one
    pose says nothing about others."""
    turned = with_symmetries(first, view.known)
    turned = PoseHypotheses(turned.poses[1:], turned.owner[1:])
    for step in FINE:
        turned = refine_poses(view.known, view.evidence, turned, step)
        turned = best_poses(turned, view.known, scorer, ANSWERS)
    return turned
