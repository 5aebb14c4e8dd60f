"""Figures of trials of the verdict: what is accepted, how often it is right, how probable it was said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.perception.measurements import rate_of
from benchmarks.perception.verdict_fit import RIGHT_HAND_MM, evidence_of, trial_weights
from benchmarks.perception.verdict_trials import RIGHT, HandTrial, VerdictTrial
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.perception.hand.joint_confidence import SURE, WITHIN, joint_confidences
from fungrasp.perception.object_pose.confidence import ACCEPT, confidence
from fungrasp.perception.object_pose.verdict_weights import HAND_WEIGHTS, OBJECT_WEIGHTS, Logistic
from fungrasp.perception.verdict import ACCEPTED_HAND

EDGES = np.array([0.0, 0.05, 0.2, 0.4, 0.7, 0.9, ACCEPT, 1.0])
"""Ranges of probabilities."""

SIZE, LEFT, TOP = 300, 60, 20
"""Of the plot [pixels]: edge of the square, space to its left and above."""


def verdict_figures(
    answers: Sequence[VerdictTrial],
    hands: Sequence[HandTrial],
    weights: Mapping[str, Logistic] | None = None,
) -> dict[str, Any]:
    """What was accepted, by what was told of the object's place and by the kind of the mesh; reliability.

    weights: as ``fitted_weights`` gives them; the package's if None.
    """
    weights = weights or {"OBJECT_WEIGHTS": OBJECT_WEIGHTS, "HAND_WEIGHTS": HAND_WEIGHTS}
    of_object = weights["OBJECT_WEIGHTS"]
    said = np.array([confidence(evidence_of(one), of_object) if one.evidence else 0.0 for one in answers])
    right = np.array([one.right for one in answers])
    accepted = said >= ACCEPT
    told: dict[str, Any] = {}
    for hint in dict.fromkeys(one.told for one in answers):
        mine = np.array([one.told == hint for one in answers])
        wrong = mine & np.array([one.mesh != RIGHT for one in answers])
        told[hint] = {
            "right_mesh": int((mine & ~wrong).sum()),
            "right_pose": rate_of(right[mine & ~wrong].tolist()),
            "right_accepted": rate_of(accepted[mine & right].tolist()),
            "wrong_pose_accepted": rate_of(accepted[mine & ~wrong & ~right].tolist()),
            "wrong_mesh_accepted": rate_of(accepted[wrong].tolist()),
        }
    kinds = {
        kind: rate_of([bool(a) for a, one in zip(accepted, answers, strict=True) if one.mesh == kind])
        for kind in dict.fromkeys(one.mesh for one in answers)
        if kind != RIGHT
    }
    hands = [one for one in hands if one.found]
    of_hands = np.array([weights["HAND_WEIGHTS"].probability(one.features) for one in hands])
    sure = of_hands >= ACCEPTED_HAND
    said_of_joints = np.concatenate([np.zeros(0), *(joint_confidences(_arrays(one.each)) for one in hands)])
    off = np.concatenate([np.zeros(0), *(_joint_errors(one) for one in hands)])
    judged = np.isfinite(off)
    sure_joints, far = said_of_joints[judged] >= SURE, off[judged] > WITHIN
    return {
        "captures": len({one.capture for one in answers}),
        "answers": len(answers),
        "accept": ACCEPT,
        "told": told,
        "kinds": kinds,
        "accepted_are_right": rate_of(right[accepted].tolist()),
        "ranges": reliability(said, right, trial_weights(answers), EDGES),
        "hands": {
            "count": len(hands),
            "right": rate_of([one.mean_mm < RIGHT_HAND_MM for one in hands]),
            "right_sure": rate_of(
                [bool(s) for s, one in zip(sure, hands, strict=True) if one.mean_mm < RIGHT_HAND_MM]
            ),
            "sure_right": rate_of(
                [one.mean_mm < RIGHT_HAND_MM for one, s in zip(hands, sure, strict=True) if s]
            ),
            "joints_sure": rate_of(sure_joints.tolist()),
            "joints_far": rate_of(far.tolist()),
            "joints_far_of_sure": rate_of(far[sure_joints].tolist()),
        },
    }


def verdict_rows(figures: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The figures as a table."""
    rows: list[tuple[str, ...]] = [
        ("told", "right poses", "right ones accepted", "wrong poses accepted", "wrong meshes accepted")
    ]
    for hint, row in figures["told"].items():
        names = ("right_pose", "right_accepted", "wrong_pose_accepted", "wrong_mesh_accepted")
        rows.append((hint, *(counted(row[name]) for name in names)))
    hands = figures["hands"]
    rows.append(("hands", counted(hands["right"]), counted(hands["right_sure"]), "", ""))
    far, all_far = counted(hands["joints_far_of_sure"]), counted(hands["joints_far"])
    rows.append(
        ("joints", f"sure {counted(hands['joints_sure'])}", f"far off {far}", f"of all {all_far}", "")
    )
    return rows


def _arrays(each: Mapping[str, Sequence[float]]) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in each.items()}


def _joint_errors(one: HandTrial) -> np.ndarray:
    """How far each joint is off [m], NaN where that is not known, shape [21]."""
    return np.linalg.norm(np.array(one.joints["refined"]) - np.array(one.joints["true"], float), axis=1)


def reliability(
    said: np.ndarray, right: np.ndarray, weights: np.ndarray, edges: np.ndarray
) -> list[dict[str, Any]]:
    """For each range of probabilities how many answers there are, their mean, and how many are right.

    Args:
        said: shape [N].
        right: shape [N] bool.
        weights: of the answers, shape [N]; wrong meshes are tried more often than people give them.
        edges: ascending, shape [B + 1]; the last range includes its upper edge.

    Returns:
        only ranges with answers; "interval" holds the 95 % interval of "right".
    """
    rows = []
    for low, high in pairwise(edges):
        mine = (said >= low) & ((said < high) | (high == edges[-1]))
        if not mine.any():
            continue
        count, part = int(mine.sum()), float(np.average(right[mine], weights=weights[mine]))
        rows.append(
            {
                "from": float(low),
                "to": float(high),
                "count": count,
                "mean_score": float(np.average(said[mine], weights=weights[mine])),
                "right": part,
                "interval": wilson_interval(round(part * count), count),
            }
        )
    return rows


def reliability_svg(figures: Mapping[str, Any]) -> str:
    """Part that is right over mean probability, with 95 % intervals and counts."""

    def x(value: float) -> float:
        return LEFT + SIZE * value

    def y(value: float) -> float:
        return TOP + SIZE * (1 - value)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE + 90}" height="{SIZE + 80}" '
        'font-family="sans-serif" font-size="12">',
        '<rect width="100%" height="100%" fill="white"/>',
        f'<rect x="{LEFT}" y="{TOP}" width="{SIZE}" height="{SIZE}" fill="none" stroke="#888"/>',
        f'<path d="M{x(0)} {y(0)}L{x(1)} {y(1)}" stroke="#bbb" stroke-dasharray="4"/>',
        f'<path d="M{x(ACCEPT)} {y(0)}V{y(1)}" stroke="#c60"/>',
        f'<text x="{x(ACCEPT) - 4}" y="{y(0.04)}" text-anchor="end" fill="#c60">accepted</text>',
    ]
    for tick in (0, 0.25, 0.5, 0.75, 1):
        parts.append(f'<text x="{x(tick)}" y="{y(0) + 18}" text-anchor="middle">{tick:g}</text>')
        parts.append(f'<text x="{LEFT - 8}" y="{y(tick) + 4}" text-anchor="end">{tick:g}</text>')
    for row in figures["ranges"]:
        across, (low, high) = x(row["mean_score"]), row["interval"]
        parts.append(f'<path d="M{across:.1f} {y(low):.1f}V{y(high):.1f}" stroke="#27c" stroke-width="1.5"/>')
        parts.append(f'<circle cx="{across:.1f}" cy="{y(row["right"]):.1f}" r="4" fill="#27c"/>')
        parts.append(f'<text x="{across + 7:.1f}" y="{y(row["right"]) + 14:.1f}">{row["count"]}</text>')
    parts += [
        f'<text x="{x(0.5)}" y="{y(0) + 38}" text-anchor="middle">probability said</text>',
        f'<text transform="translate(16 {y(0.5)}) rotate(-90)" text-anchor="middle">part right</text>',
        f'<text x="{x(0.5)}" y="{y(0) + 56}" text-anchor="middle">{figures["answers"]} answers; their number '
        "beside each mark</text>",
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def counted(rate: Mapping[str, Any] | None) -> str:
    """A rate of ``rate_of`` as words: "3 of 8"."""
    if rate is None:
        return "none"
    return f"{round(rate['rate'] * rate['count'])} of {rate['count']}"
