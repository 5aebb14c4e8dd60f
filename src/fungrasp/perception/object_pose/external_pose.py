"""The score of a pose from another program: compared with the depth, as our own answers are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import ACCEPT, RIVAL_DISTANCE, confidence
from fungrasp.perception.object_pose.estimate import RAYS
from fungrasp.perception.object_pose.evidence import PoseEvidence, pose_evidence
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
from fungrasp.perception.object_pose.search import PoseHypotheses, PoseSearchSettings, refine_poses

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
        The answer with its score. Not accepted where the depth says nothing about the object; the warning
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
    pose, score, evidence, residual = _scored(thing.pose_camera_object, view, view.scorer(RAYS), rng, improve)
    return ObjectEstimate(pose, score, score >= ACCEPT, (), residual, evidence=evidence)


def _scored(
    pose: np.ndarray, view: ObjectView, scorer: PoseScorer, rng: np.random.Generator, improve: bool
) -> tuple[np.ndarray, float, PoseEvidence, float]:
    """A pose, or the best fit nearby; its probability; what that is made of; how far it is off [m]."""
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
    evidence = pose_evidence(view, scorer, poses[best], int(owners[best]), 0.0, rng)
    return chosen, confidence(evidence), evidence, residual
