"""The score of a pose from another program: compared with the depth, as our own answers are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import RIVAL_DISTANCE
from fungrasp.perception.object_pose.estimate import ANSWERS, RAYS, PoseAnswers, best_estimate
from fungrasp.perception.object_pose.evidence import pose_evidence
from fungrasp.perception.object_pose.known_object import known_object
from fungrasp.perception.object_pose.object_view import (
    LEAST_PIXELS,
    ObjectView,
    explained_mask,
    object_evidence,
    thinned,
    view_of_object,
)
from fungrasp.perception.object_pose.pose_error import add_s
from fungrasp.perception.object_pose.scoring import PoseScorer
from fungrasp.perception.object_pose.search import (
    PoseHypotheses,
    PoseSearchSettings,
    best_poses,
    refine_poses,
    with_symmetries,
)

if TYPE_CHECKING:
    import trimesh

ALLOWED = 0.25
"""A pixel whose confidence to show a thing is below this is not the object's."""


def score_given_pose(
    thing: ObjectEstimate,
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh,
    hand: HandEstimate | None = None,
    table: np.ndarray | None = None,
    *,
    seed: int = 0,
    improve: bool = False,
) -> ObjectEstimate:
    """The same answer with the score that the depth gives it, whatever score its program gave.

    The score means what it means for our own answers: the confidence that the mesh is within 10 mm (ADD-S) of
    the pose. The best fit to the depth nearby is looked for; if it is within 10 mm, its score is the pose's.

    Args:
        thing: a pose as another program gave it.
        capture: color and depth.
        mesh: the object [m].
        hand: what holds it, if known.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], if known.
        seed: the same seed gives the same answer.
        improve: whether to give the best fit nearby instead of the pose itself.

    Returns:
        The answer with its score, and as alternatives the poses that the mesh's near-symmetries make of it,
        each as it fits best. Not accepted where the depth says nothing about the object; the warning
        says why.

    Raises:
        FungraspError: the mesh has no faces.
    """
    known, rng = known_object(mesh), np.random.default_rng(seed)
    joints = None if hand is None else hand.joints_camera
    view, problem = view_of_object(known, thinned(capture), joints, table, rng)
    if view is None:
        warnings = (PerceptionWarning.of("not_comparable", problem=problem),)
        return replace(thing, score=0.0, accepted=False, alternatives=(), warnings=warnings, judged=True)
    pose, answers = _scored(thing.pose_camera_object, view, view.scorer(RAYS), rng, improve)
    return replace(best_estimate(answers), pose_camera_object=pose)


def _scored(
    pose: np.ndarray, view: ObjectView, scorer: PoseScorer, rng: np.random.Generator, improve: bool
) -> tuple[np.ndarray, PoseAnswers]:
    """A pose, or the best fit nearby; that fit and what near-symmetries make of it, with their scores."""
    known, rounds = view.known, PoseSearchSettings().rounds
    evidence = list(view.evidence)
    mask = explained_mask(known, view.capture, pose, view.support > ALLOWED)
    if mask.sum() > LEAST_PIXELS:
        evidence.append(object_evidence(view.capture, mask, view.seen, view.table, rng))
    found = PoseHypotheses(np.repeat(pose[None], len(evidence), axis=0), np.arange(len(evidence)))
    for step in rounds[3:]:
        found = refine_poses(known, evidence, found, step)
    # The last one was fitted to what the pose explains, which is no proposal: all proposals score it.
    proposals = np.arange(len(view.masks))
    fits = [(fit, owner) for fit, own in zip(found.poses, found.owner, strict=True)
            for owner in (proposals if own >= len(proposals) else [own])]  # fmt: skip
    poses = np.array([*(fit for fit, _ in fits), *(pose for _ in proposals)])
    owners = np.array([*(owner for _, owner in fits), *proposals])
    scores = scorer(poses, owners)
    near = add_s(known.surface.samples, poses, pose) < RIVAL_DISTANCE
    best = int(np.argmax(np.where(near, scores.quality, -1.0)))
    chosen = poses[best] if improve else pose
    residual = known.surface.median_distance(view.evidence[owners[best]].points, chosen)
    first = PoseHypotheses(poses[best : best + 1], owners[best : best + 1])
    others = _turned(first, view, scorer)
    answers = np.concatenate([first.poses, others.poses])
    scores = scorer(answers, np.concatenate([first.owner, others.owner]))
    evidence = pose_evidence(view, scorer, poses[best], int(owners[best]), 0.0, rng)
    return chosen, PoseAnswers(answers, scores, residual, evidence)


def _turned(first: PoseHypotheses, view: ObjectView, scorer: PoseScorer) -> PoseHypotheses:
    """What the mesh's near-symmetries make of a pose, each fitted to the depth, best first: a program that
    gives one pose does not say which way round the object may be as well."""
    turned = with_symmetries(first, view.known)
    turned = PoseHypotheses(turned.poses[1:], turned.owner[1:])
    for step in PoseSearchSettings().rounds[3:]:
        turned = refine_poses(view.known, view.evidence, turned, step)
        turned = best_poses(turned, view.known, scorer, ANSWERS)
    return turned
