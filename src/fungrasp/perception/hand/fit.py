"""Metric fit of a hand to an image, with or without the object that it holds.

Landmarks give joint positions in the image; depth gives the position of the skin and excludes free space; the
landmark model's 3D shape gives approximate bone directions; anatomy limits lengths and angles; the object,
once its pose is known, gives contacts. Depth is trusted only where it agrees with the rest: a joint behind
the object appears too near, one beside its landmark too far.
"""

from __future__ import annotations

import dataclasses
from contextlib import suppress

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.grasps.human_hand import FINGER_RADII, WRIST_RADIUS
from fungrasp.perception.hand.detected_hand import MIRROR_X, DetectedHand
from fungrasp.perception.hand.finger_search import search_fingers
from fungrasp.perception.hand.fit_problem import (
    HandFitProblem,
    HandFitStage,
    HandParameters,
    joint_confidence,
)
from fungrasp.perception.hand.hand_measurements import HandMeasurements, HandView, hand_view, mirror_estimate
from fungrasp.perception.hand.physical_evidence import HandSurroundings, anatomy_evidence
from fungrasp.perception.hand.skeleton import (
    BASES,
    SIZE,
    HandEvidence,
    Skeleton,
    damped_step,
    normal_equations,
)
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, Side

# Stages of a fit without the object.
FREE_STAGES = tuple(HandFitStage(outlier) for outlier in ((0.02, 0.04), (0.008, 0.03)))
# Stages of a fit with the object, before the fingers are searched.
PALM_STAGES = (HandFitStage((0.06, 0.06), 0.05), HandFitStage((0.02, 0.04), 0.03))
# Stage of a fit with the object, after the fingers are searched.
HELD_STAGE = HandFitStage((0.02, 0.03), 0.015, contact=True, late=True)
# Stage that compares candidates and gives the final estimate.
COMPARED = HandFitStage((0.02, 0.03), 0.02, contact=True, late=True)
STAGE_ITERATIONS = 5  # Gauss-Newton steps of a stage.
THROUGH_ITERATIONS = 8  # Gauss-Newton steps of ``skeleton_through``.
REFINE_ITERATIONS = 10  # Gauss-Newton steps of ``refine_hand``.
FITTED_SPREAD = 0.004  # Standard deviation of given joints from which a candidate starts [m].
OTHER_SIDE = 0.8  # Probability of a side below which the other side is tried as well.

_PALM_JOINTS = np.array([0, 1, 5, 9, 13])
_AGREEMENT = 0.012


def fit_hand(detected: DetectedHand, capture: Capture) -> HandEstimate:
    """Fit a hand without knowledge of the object.

    Returns:
        Hand in the camera frame; a left hand is not mirrored.

    Raises:
        FungraspError: there is no depth at the hand.
    """
    problem = HandFitProblem(seen=HandMeasurements.of(detected, capture))
    assert problem.seen is not None
    parameters = _in_stages(problem, HandParameters(initial_skeleton(problem.seen)), FREE_STAGES)
    return _estimate(problem, parameters, FREE_STAGES[-1], detected)


def fit_held_hand(
    detected: DetectedHand,
    capture: Capture,
    surroundings: HandSurroundings,
    joints: np.ndarray,
    *,
    side: Side | None = None,
    seed: int = 0,
) -> HandEstimate:
    """Fit a hand that holds a known object.

    Candidates start from the landmarks, for each possible side of the hand, and from the hand fitted without
    the object. Each is fitted to landmarks, depth, measured points of the hand, contacts with the object and
    free space. As fingers may be behind the object, they are searched, too. The candidate of least cost wins.

    Args:
        detected: landmarks in the color image.
        joints: joints fitted without the object [m], camera frame, shape [21, 3].
        side: side of the hand, if known.

    Raises:
        FungraspError: there is no depth at the hand.
    """
    begun: list[tuple[DetectedHand, HandMeasurements, Skeleton]] = []
    for guess in _guesses(detected, side):
        seen = HandMeasurements.of(guess, capture)
        with suppress(FungraspError):
            begun.append((guess, seen, initial_skeleton(seen)))
    if not begun:
        raise FungraspError("there is no depth where the hand is in the image")
    guess, seen, _ = begun[0]
    begun.append((guess, seen, skeleton_through(joints * _flip(guess), FITTED_SPREAD)))
    everywhere = [skeleton.joints() * _flip(guess) for guess, _, skeleton in begun]
    view = hand_view(capture, surroundings, [joints, *everywhere])
    views: dict[Side, HandView] = {"right": view, "left": view.mirrored()}
    fitted = []
    for guess, seen, skeleton in begun:
        problem = HandFitProblem(seen=seen, view=views[guess.side])
        parameters = _in_stages(problem, HandParameters(skeleton), PALM_STAGES)
        parameters = _with_fingers_searched(problem, parameters, seed)
        fitted.append((problem.cost(parameters, COMPARED), problem, parameters, guess))
    _, problem, parameters, guess = min(fitted, key=lambda candidate: candidate[0])
    return _estimate(problem, parameters, COMPARED, guess)


def refine_hand(hand: HandEstimate, surroundings: HandSurroundings) -> HandEstimate:
    """Fit a hand from another estimator to the object: no contact gaps, no penetration.

    Joints are weighted by their covariances.

    Returns:
        The hand with new joints, covariances and confidences.
    """
    if hand.side == "left":
        mirrored = refine_hand(mirror_estimate(hand, hand.pixels), surroundings.mirrored())
        return mirror_estimate(mirrored, hand.pixels)
    problem = HandFitProblem(estimate=hand, surroundings=surroundings)
    start = HandParameters(skeleton_through(hand.joints_camera, FITTED_SPREAD))
    parameters = problem.solve(start, COMPARED, REFINE_ITERATIONS)
    joints, covariance = problem.joints(parameters, problem.evidence(parameters, COMPARED))
    confidence = joint_confidence(covariance)
    return dataclasses.replace(hand, joints_camera=joints, covariance=covariance, confidence=confidence)


def _in_stages(
    problem: HandFitProblem, parameters: HandParameters, stages: tuple[HandFitStage, ...]
) -> HandParameters:
    for stage in stages:
        problem.find_background(parameters.skeleton)
        parameters = problem.solve(parameters, stage, STAGE_ITERATIONS)
    return parameters


def _with_fingers_searched(problem: HandFitProblem, parameters: HandParameters, seed: int) -> HandParameters:
    assert problem.seen is not None and problem.view is not None
    skeleton = search_fingers(
        parameters.skeleton,
        problem.view,
        problem.seen.pixels,
        problem.seen.spread,
        np.random.default_rng(seed),
    )
    parameters = HandParameters(skeleton, parameters.turn)
    problem.find_background(skeleton)
    parameters = problem.solve(parameters, HELD_STAGE, STAGE_ITERATIONS)
    problem.find_background(parameters.skeleton)
    return parameters


def _estimate(
    problem: HandFitProblem, parameters: HandParameters, stage: HandFitStage, detected: DetectedHand
) -> HandEstimate:
    """Return the fitted hand, mirrored back if it is a left one."""
    assert problem.seen is not None
    evidence = problem.evidence(parameters, stage)
    joints, covariance = problem.joints(parameters, evidence)
    score = problem.seen.score * problem.agreement(parameters, evidence)
    confidence = joint_confidence(covariance)
    right = HandEstimate(joints, problem.seen.pixels, confidence, covariance, "right", score)
    return right if detected.side == "right" else mirror_estimate(right, detected.pixels)


def _flip(guess: DetectedHand) -> np.ndarray:
    """Return the factors that mirror a right hand to the guess's side, and back, shape [3]."""
    return MIRROR_X if guess.side == "left" else np.ones(3)


def _guesses(detected: DetectedHand, side: Side | None) -> list[DetectedHand]:
    """Return the hand for each possible side, the most probable first."""
    sides: list[Side] = [side or detected.side]
    if side is None and detected.side_score < OTHER_SIDE:
        sides.append("left" if detected.side == "right" else "right")
    return [dataclasses.replace(detected, side=one) for one in sides]


def initial_skeleton(seen: HandMeasurements) -> Skeleton:
    """Place the landmark model's shape at the depth that most landmarks agree on.

    Raises:
        FungraspError: there is no depth at the hand.
    """
    measured = seen.measured(seen.pixels)
    known = measured > 0
    if not known.any():
        raise FungraspError(
            "there is no depth where the hand is in the image: is it too near or too far for the camera, or "
            "is the depth not aligned to the color?"
        )
    rough = float(np.median(measured[known]))
    radius = np.concatenate([[WRIST_RADIUS], FINGER_RADII.ravel()])
    offsets = np.zeros(21)
    for _ in range(2):
        points = seen.intrinsics.deproject(seen.pixels, np.full(21, rough))
        wide = np.var(points[:, :2], axis=0).sum() / max(np.var(seen.shape[:, :2], axis=0).sum(), 1e-9)
        offsets = np.sqrt(wide) * (seen.shape[:, 2] - seen.shape[:, 2].mean())
        rough = _densest((measured + radius - offsets)[known])
    depth = np.maximum(rough + offsets, 0.1)
    return skeleton_through(seen.intrinsics.deproject(seen.pixels, depth), 0.015)


def skeleton_through(points: np.ndarray, spread: float) -> Skeleton:
    """Fit the skeleton of a right hand to given joints.

    Args:
        points: [m], shape [21, 3].
        spread: standard deviation of the points [m]; the larger it is, the more anatomy counts.
    """
    template = np.vstack([np.zeros(3), BASES[:4]])
    placed = points[_PALM_JOINTS] - points[_PALM_JOINTS].mean(axis=0)
    turn = Rotation.align_vectors(placed, template - template.mean(axis=0))[0].as_matrix()
    hand = Skeleton.usual(points[0], turn)
    for _ in range(THROUGH_ITERATIONS):
        joints, jacobian = hand.joints_and_derivatives()
        near = HandEvidence(((joints - points) / spread).ravel(), jacobian.reshape(63, SIZE) / spread)
        hand = hand.moved(damped_step(*normal_equations([near, *anatomy_evidence(hand)], SIZE)))
    return hand


def _densest(values: np.ndarray) -> float:
    """Return the mean of the densest cluster of values [m]."""
    near = np.abs(values[:, None] - values) < _AGREEMENT
    return float(values[near[near.sum(axis=1).argmax()]].mean())
