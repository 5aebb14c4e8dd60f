"""The pose of a known mesh from one depth image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import (
    ACCEPT,
    best_rival,
    confidence,
)
from fungrasp.perception.object_pose.evidence import PoseEvidence, pose_evidence
from fungrasp.perception.object_pose.known_object import KnownObject, known_object
from fungrasp.perception.object_pose.object_view import (
    LEAST_PIXELS,
    ObjectView,
    explained_mask,
    object_evidence,
    thinned,
    view_of_object,
)
from fungrasp.perception.object_pose.scoring import PoseScores, color_agreement
from fungrasp.perception.object_pose.search import (
    PoseHypotheses,
    PoseSearchSettings,
    best_poses,
    polish_poses,
    refine_poses,
    search_poses,
    with_symmetries,
)
from fungrasp.perception.scene.depth_edges import SHARP
from fungrasp.perception.scene.segmentation import TIPS
from fungrasp.perception.scene.table import largest_plane

if TYPE_CHECKING:
    import trimesh

SIZES = (0.01, 1.5)
"""Shortest and longest diagonal of an object that a hand holds [m]."""

GOOD = (0.85, 0.6)
"""Quality of an answer that needs no second search, with and without a mask."""

GOOD_SMOOTHED = 0.55
"""The same where depth is smoothed: no answer is as good there, and polishing makes up for it."""

COLOR_WEIGHT = 0.15
"""Quality that full agreement of colors adds, as a part of the best pose's."""

POLISHED = 6
"""Poses that are polished where depth is smoothed."""

RAYS = 1000
"""About how many rays that meet a mask an answer is judged by."""

ANSWERS = 5
"""Most alternatives that are kept."""


@dataclass(frozen=True, eq=False)
class PoseAnswers:
    """Different poses of the object, best first, and what speaks for each."""

    poses: np.ndarray
    """Object in the camera frame, shape [H, 7]."""
    scores: PoseScores
    """How well each of the H poses explains the image."""
    residual_m: float
    """Median distance of the object's measured points from the mesh in the first pose [m]."""
    evidence: PoseEvidence | None = None
    """What speaks for and against the first pose and the mesh; None where nothing was searched for."""
    problem: PerceptionWarning | None = None
    """Why nothing was searched for; the pose is then a guess of the place only."""


def estimate_object_pose(
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh,
    hand: HandEstimate | None = None,
    table: np.ndarray | None = None,
    *,
    seed: int = 0,
) -> ObjectEstimate:
    """Find a known object in a depth image.

    The object's pixels are those of the capture's mask; without one, several masks are proposed from table,
    hand and box, and the fit decides. An answer that the image does not support is still given, with
    ``accepted`` False and warnings.

    Args:
        capture: color and depth.
        mesh: the object [m]; a trimesh with colors settles which way round a nearly symmetric object is.
        hand: what holds it, if known.
        table: plane ``[nx ny nz d]`` with ``n . x + d`` the height of a point above it [m], camera frame,
            shape [4]; looked for in the image if None.
        seed: the same seed gives the same answer.

    Raises:
        FungraspError: the mesh has no faces.
    """
    return best_estimate(search_object_pose(capture, mesh, hand, table, seed=seed))


def search_object_pose(
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh | KnownObject,
    hand: HandEstimate | None = None,
    table: np.ndarray | None = None,
    *,
    seed: int = 0,
) -> PoseAnswers:
    """All that ``estimate_object_pose`` finds, with the scores of each pose."""
    capture = thinned(capture)
    if isinstance(mesh, KnownObject):
        size = mesh.size
    else:
        size = float(np.linalg.norm(np.ptp(np.asarray(mesh.vertices), axis=0))) if len(mesh.vertices) else 0.0
    joints = None if hand is None else hand.joints_camera
    if not SIZES[0] < size < SIZES[1]:
        unit = "; is it in millimetres?" if size >= SIZES[1] else ""
        return _nothing(
            capture,
            joints,
            PerceptionWarning.of("not_searched", problem=f"the mesh is {size:.4g} m large{unit}"),
        )
    known, rng = known_object(mesh), np.random.default_rng(seed)
    if table is None:
        table = largest_plane(capture, rng)
    view, problem = view_of_object(known, capture, joints, table, rng)
    if problem or view is None:
        return _nothing(capture, joints, PerceptionWarning.of("not_searched", problem=problem))
    found, scores, color = _answers(view, rng)
    order = np.argsort(-(scores.quality + COLOR_WEIGHT * scores.quality.max() * color))
    poses, scores = found.poses[order], scores.chosen(order)
    owner = int(found.owner[order[0]])
    points = view.evidence[owner].points
    rival = best_rival(known, poses, scores.quality)
    evidence = pose_evidence(view, view.scorer(RAYS), poses[0], owner, rival, rng)
    return PoseAnswers(poses, scores, known.surface.median_distance(points, poses[0]), evidence)


def best_estimate(answers: PoseAnswers) -> ObjectEstimate:
    """The best answer with its probability, and the others."""
    poses, first = answers.poses, answers.evidence
    if first is None:
        problem = () if answers.problem is None else (answers.problem,)
        return ObjectEstimate(poses[0], 0.0, False, warnings=problem)
    score = confidence(first)
    others = []
    for i in range(1, min(len(poses), ANSWERS + 1)):
        # What is not known of another pose is taken to be as with the first.
        explained = float(answers.scores.explained[i] * answers.scores.quality[i] / answers.scores.quality[0])
        other = replace(first, explained=min(explained, first.explained))
        others.append((poses[i], min(confidence(other), score)))
    return ObjectEstimate(poses[0], score, score >= ACCEPT, tuple(others), answers.residual_m, evidence=first)


def _answers(view: ObjectView, rng: np.random.Generator) -> tuple[PoseHypotheses, PoseScores, np.ndarray]:
    """Different poses, their scores, and the agreement of their colors."""
    settings = PoseSearchSettings()
    few, many = view.scorer(250), view.scorer(RAYS)
    known, evidence = view.known, view.evidence
    found = search_poses(known, evidence, (few, many), rng, settings)
    masked = view.capture.mask is not None
    good = GOOD[0 if masked else 1] if view.seen.edge_width <= SHARP else GOOD_SMOOTHED
    if float(many(found.poses, found.owner).quality.max()) < good:
        harder = replace(settings, rotations=2 * settings.rotations)
        again = search_poses(known, evidence, (few, many), rng, harder)
        found = PoseHypotheses(
            np.concatenate([found.poses, again.poses]), np.concatenate([found.owner, again.owner])
        )
    if not masked:
        found = best_poses(found, known, many, 6)
        allowed = view.support > 0.25
        masks = [explained_mask(known, view.capture, pose, allowed) for pose in found.poses[:3]]
        sharper = [
            object_evidence(view.capture, mask, view.seen, view.table, rng)
            for mask in masks
            if mask.sum() > LEAST_PIXELS
        ]
        for seen in sharper:
            best = found.poses[:3]
            poses = refine_poses(
                known, [seen], PoseHypotheses(best, np.zeros(len(best), int)), settings.rounds[-1]
            ).poses
            found = PoseHypotheses(
                np.concatenate([found.poses, poses]), np.concatenate([found.owner, found.owner[:3]])
            )
    if len(known.symmetries):
        # What tells the sides apart may be hidden: then all are answers, and colors may tell.
        found = refine_poses(
            known, evidence, with_symmetries(best_poses(found, known, many, 2), known), settings.rounds[3]
        )
        found = refine_poses(known, evidence, best_poses(found, known, many, 24), settings.rounds[4])
    if view.seen.edge_width > SHARP:
        best = best_poses(found, known, many, POLISHED)
        best = polish_poses(best, known, few, rng)
        found = PoseHypotheses(
            np.concatenate([found.poses, best.poses]), np.concatenate([found.owner, best.owner])
        )
    found = best_poses(found, known, many, 24)
    color = color_agreement(known, view.capture, found.poses, view.support > 0.25)
    return found, many(found.poses, found.owner), color


def _nothing(capture: Capture, joints: np.ndarray | None, why: PerceptionWarning) -> PoseAnswers:
    """No answer: a pose in the middle of what is known, and the reason."""
    if joints is not None:
        middle = joints[list(TIPS)].mean(axis=0)
    else:
        shown = capture.measured if capture.mask is None else capture.mask & capture.measured
        points = capture.points()[shown if shown.any() else capture.measured]
        middle = np.median(points, axis=0)
    pose = np.concatenate([middle, [1.0, 0.0, 0.0, 0.0]])
    none = PoseScores(*np.zeros((6, 1)))
    return PoseAnswers(pose[None], none, float("nan"), problem=why)
