"""The hand that holds a known object: several guesses are fitted to all that is seen of it, and judged.

A guess is the answer of the landmark model in one window of the image, taken for one side. It is fitted to
the landmarks, to depth, to the points that show the hand, to the object that it touches and to the free space
that it can't be in. Its fingers are searched, too, as they may be behind the object. The guess that leaves
least unexplained wins.
"""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.perception.estimates import HandEstimate, Side
from fungrasp.perception.hand.detection import DetectedHand
from fungrasp.perception.hand.finger_search import FingerSettings, search_fingers
from fungrasp.perception.hand.hand_pixels import HandView, look
from fungrasp.perception.hand.held_problem import Fit, HeldProblem, HeldSettings
from fungrasp.perception.hand.initial_skeleton import (
    MIRROR_X,
    HandMeasurements,
    mirror_estimate,
    skeleton_through,
    start,
)
from fungrasp.perception.hand.object_contact import Surroundings
from fungrasp.perception.hand.skeleton import Skeleton
from fungrasp.perception.io.capture import Capture

SAME_GUESS = 0.035
"""Guesses whose landmarks differ by less, on average and as a part of the hand's extent, are one."""

SEARCHED = 3
"""So many guesses, the best before that, have their fingers searched."""

MOST_GUESSES = 8
"""So many are fitted at all."""

FITTED = 0.004
"""How near a guess begins to the hand that was fitted without the object [m]."""

OTHER_SIDE = 0.8
"""If a side is less probable than this, the other is tried, too."""

_STAGES = (((0.06, 0.06), 0.05), ((0.02, 0.04), 0.03))
"""How far in front of and behind the skin something else is seen, and how far from it is no point of the hand
[m]: before the fingers are searched."""

_HELD_STAGES = (((0.02, 0.03), 0.02), ((0.02, 0.03), 0.015))
"""The same afterwards."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    guess: DetectedHand
    problem: HeldProblem
    fit: Fit
    cost: float


def fit_held(
    detected: DetectedHand,
    capture: Capture,
    around: Surroundings,
    joints: np.ndarray,
    *,
    side: Side | None = None,
    settings: HeldSettings | None = None,
) -> HandEstimate:
    """The hand that holds the object.

    Args:
        detected: landmarks in the colour image, and what other windows said.
        capture: the same image with depth.
        around: object and table.
        joints: of the hand as it was fitted without them [m], camera frame, shape [21, 3].
        side: which hand it is, if that is known.
        settings: what the measurements are worth.

    Raises:
        FungraspError: there is no depth where the hand is.
    """
    settings = settings or HeldSettings()
    begun: list[tuple[DetectedHand, HandMeasurements, Skeleton]] = []
    for guess in _guesses(detected, side):
        seen = HandMeasurements.of(guess, capture)
        with suppress(FungraspError):
            begun.append((guess, seen, start(seen)))
    if not begun:
        raise FungraspError("there is no depth where the hand is in the image")
    first, seen, _ = begun[0]
    begun.append((first, seen, skeleton_through(joints * _flip(first), FITTED)))
    everywhere = [hand.joints() * _flip(guess) for guess, _, hand in begun]
    view = look(capture, around, [joints, *everywhere])
    views: dict[Side, HandView] = {"right": view, "left": view.mirrored()}
    candidates = [
        _first_fit(guess, HeldProblem(seen, views[guess.side], settings), hand) for guess, seen, hand in begun
    ]
    candidates.sort(key=lambda candidate: candidate.cost)
    best = min((_searched(candidate) for candidate in candidates[:SEARCHED]), key=lambda c: c.cost)
    right = best.problem.estimate(best.fit)
    return right if best.guess.side == "right" else mirror_estimate(right, best.guess.pixels)


def _flip(guess: DetectedHand) -> np.ndarray:
    """Takes a right hand to the guess's side, and back."""
    return MIRROR_X if guess.side == "left" else np.ones(3)


def _guesses(detected: DetectedHand, side: Side | None) -> list[DetectedHand]:
    """Guesses that differ, the most probable first."""
    kept: list[DetectedHand] = []
    every = sorted((detected, *detected.others), key=lambda guess: guess is not detected)
    for guess in every:
        if all(guess.distance(other) > SAME_GUESS * guess.extent for other in kept):
            kept.append(guess)
    sides: list[Side] = [side or detected.side]
    if side is None and detected.side_score < OTHER_SIDE:
        sides.append("left" if detected.side == "right" else "right")
    guesses = [
        dataclasses.replace(guess, side=one, score=detected.score, others=())
        for guess in kept
        for one in sides
    ]
    return guesses[:MOST_GUESSES]


def _first_fit(guess: DetectedHand, problem: HeldProblem, hand: Skeleton) -> _Candidate:
    fit = Fit(hand, np.zeros(3))
    for outlier, far in _STAGES:
        problem.look(fit.hand)
        fit = problem.solve(fit, outlier, far, 5, contact=False)
    return _Candidate(guess, problem, fit, problem.cost(fit, contact=False))


def _searched(candidate: _Candidate) -> _Candidate:
    problem, fit = candidate.problem, candidate.fit
    rng = np.random.default_rng(0)
    seen = problem.seen
    hand = search_fingers(fit.hand, problem.view, seen.pixels, rng, FingerSettings(), seen.spread)
    fit = Fit(hand, fit.turn)
    problem.look(hand)
    for outlier, far in _HELD_STAGES:
        fit = problem.solve(fit, outlier, far, 5, contact=True)
    problem.look(fit.hand)
    return dataclasses.replace(candidate, fit=fit, cost=problem.cost(fit))
