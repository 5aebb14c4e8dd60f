"""How sure a pose is that another program says: compared with the depth, as our own answers are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import ACCEPT, RIVAL_DISTANCE, confidence, doubts, features
from fungrasp.perception.object_pose.known_object import known_object
from fungrasp.perception.object_pose.pose_error import add_s
from fungrasp.perception.object_pose.prepared_view import LEAST_PIXELS, View, make_view, thinned
from fungrasp.perception.object_pose.scoring import Judge, Verdict
from fungrasp.perception.object_pose.search import Found, SearchSettings, explained_mask, gather, refine

RAYS = 1000
"""About how many rays a pose is judged by; as many as our own answers."""

ALLOWED = 0.25
"""A pixel that shows a thing less surely than this is not the object's."""


def judge_estimate(
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

    The score means what it means for our own answers: how sure it is that the mesh is within 10 mm (ADD-S) of
    the pose. The best fit to the depth nearby is looked for; if it is within 10 mm, its score is the pose's.

    Args:
        thing: poses as another program gave them.
        capture: colour and depth.
        mesh: the object [m].
        hand: what holds it, if known.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], if known.
        seed: the same seed gives the same answer.
        improve: whether to give the best fits nearby instead of the poses themselves.

    Returns:
        The program's best answer with its score; the others follow in the order of theirs. Not accepted where
        the depth says nothing about the object; the note says why.

    Raises:
        FungraspError: the mesh has no faces.
    """
    known, rng = known_object(mesh), np.random.default_rng(seed)
    joints = None if hand is None else hand.joints_camera
    view, problem = make_view(known, thinned(capture), joints, table, rng)
    if view is None:
        note = f"not sure: it can't be compared with the depth: {problem}"
        return replace(thing, score=0.0, accepted=False, alternatives=(), note=note, judged=True)
    judge = view.judge(RAYS)
    answers = [
        _judged(pose, view, judge, rng, improve)
        for pose in (thing.pose_camera_object, *(pose for pose, _ in thing.alternatives))
    ]
    (pose, score, verdict, residual), *rest = answers
    others = tuple(sorted(((p, s) for p, s, _, _ in rest), key=lambda answer: -answer[1]))
    note = ""
    if score < ACCEPT:
        note = f"not sure: {doubts(verdict, np.zeros(1), view.capture.mask is not None)}"
        if others and others[0][1] >= ACCEPT:
            note += f"; another of the program's poses fits, with a score of {others[0][1]:.2f}"
    return ObjectEstimate(pose, score, score >= ACCEPT, others, residual, note)


def _judged(
    pose: np.ndarray, view: View, judge: Judge, rng: np.random.Generator, improve: bool
) -> tuple[np.ndarray, float, Verdict, float]:
    """A pose, or the best fit nearby; its score; what speaks for it; how far from it the object is [m]."""
    known, rounds = view.known, SearchSettings().rounds
    evidence = list(view.evidence)
    mask = explained_mask(known, view.capture, pose, view.support > ALLOWED)
    if mask.sum() > LEAST_PIXELS:
        evidence.append(gather(view.capture, mask, view.table, rng))
    found = Found(np.repeat(pose[None], len(evidence), axis=0), np.arange(len(evidence)))
    for step in rounds[3:]:
        found = refine(known, evidence, found, step)
    # The last one was fitted to what the pose explains, which is no proposal: all proposals judge it.
    proposals = np.arange(len(view.masks))
    fits = [(fit, owner) for fit, own in zip(found.poses, found.owner, strict=True)
            for owner in (proposals if own >= len(proposals) else [own])]  # fmt: skip
    poses = np.array([*(fit for fit, _ in fits), *(pose for _ in proposals)])
    owners = np.array([*(owner for _, owner in fits), *proposals])
    verdict = judge(poses, owners)
    scores = confidence(features(verdict, np.zeros(len(poses))))
    near = add_s(known.surface.samples, poses, pose) < RIVAL_DISTANCE
    best = int(np.argmax(np.where(near, verdict.quality, -1.0)))
    chosen = poses[best] if improve else pose
    residual = known.surface.median_distance(view.evidence[owners[best]].points, chosen)
    return chosen, float(scores[best]), verdict.chosen(np.array([best])), residual
