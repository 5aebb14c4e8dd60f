"""Makes docs/lab/perception-calibration.json and its plot from ``python -m benchmarks.perception captures``.

``python -m benchmarks.documents.calibration BENCH.json [BENCH.json ...]`` takes the answers of several runs
together.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.perception.measurements import RIGHT_MM
from fungrasp.evaluation.results import finite
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.perception.object_pose.confidence import ACCEPT

LAB = Path(__file__).parents[2] / "docs" / "lab"
EDGES = np.array([0.0, 0.1, 0.25, 0.5, ACCEPT, 0.9, 0.97, 1.0])
"""Ranges of scores."""

SIZE, LEFT, TOP = 300, 60, 20
"""Of the plot [pixels]: edge of the square, space to its left and above."""


@dataclass(frozen=True, eq=False)
class Answers:
    """N pose answers, and whether they were right."""

    right: np.ndarray
    """Shape [N] bool."""
    score: np.ndarray
    """What they were given, shape [N]."""
    group: np.ndarray
    """Name of the object in the image, shape [N]."""


def answers_of(rows: Sequence[Mapping[str, Any]]) -> Answers:
    """The pose answers in the "each" of ``python -m benchmarks.perception captures --json``: with mask,
    without, of wrong meshes and absent objects; without those that found nothing at all, whose score is 0 by
    rule."""
    found = []
    for row in rows:
        absent = None if row["absent"] is None else row["absent"]["pose"]
        for answer in (row["masked"], row["unmasked"], row["wrong_mesh"], absent):
            if answer is not None and answer["evidence"]:
                # None stands for infinite: no pose is right.
                right = answer["add_s_mm"] is not None and answer["add_s_mm"] < RIGHT_MM
                found.append((right, answer["score"], row["object_name"]))
    return Answers(*(np.array(column) for column in zip(*found, strict=True)))


def figures(answers: Answers) -> dict[str, Any]:
    """What the score was worth."""
    accepted = answers.score >= ACCEPT
    given = np.where(answers.right, answers.score, 1.0 - answers.score)
    count, right = int(accepted.sum()), int(answers.right[accepted].sum())
    return {
        "answers": len(answers.score),
        "objects": np.unique(answers.group).tolist(),
        "right": int(answers.right.sum()),
        "accept": ACCEPT,
        "accepted": count,
        "accepted_and_right": right,
        "accepted_right_interval": wilson_interval(right, count) if count else None,
        "right_but_not_accepted": int((answers.right & ~accepted).sum()),
        "log_loss": float(-np.log(np.clip(given, 1e-6, 1.0)).mean()),
        "ranges": reliability(answers.score, answers.right, EDGES),
    }


def plot(numbers: dict[str, Any]) -> str:
    """Part that is right over mean score, with 95 % intervals and counts, as SVG."""

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
    for row in numbers["ranges"]:
        across, (low, high) = x(row["mean_score"]), row["interval"]
        parts.append(f'<path d="M{across:.1f} {y(low):.1f}V{y(high):.1f}" stroke="#27c" stroke-width="1.5"/>')
        parts.append(f'<circle cx="{across:.1f}" cy="{y(row["right"]):.1f}" r="4" fill="#27c"/>')
        parts.append(f'<text x="{across + 7:.1f}" y="{y(row["right"]) + 14:.1f}">{row["count"]}</text>')
    parts += [
        f'<text x="{x(0.5)}" y="{y(0) + 38}" text-anchor="middle">score</text>',
        f'<text transform="translate(16 {y(0.5)}) rotate(-90)" text-anchor="middle">part right</text>',
        f'<text x="{x(0.5)}" y="{y(0) + 56}" text-anchor="middle">{numbers["answers"]} answers; their number '
        "beside each mark</text>",
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def reliability(score: np.ndarray, right: np.ndarray, edges: np.ndarray) -> list[dict[str, Any]]:
    """For each range of scores how many answers there are, their mean score, and how many are right.

    Args:
        score: shape [N].
        right: shape [N] bool.
        edges: ascending, shape [B + 1]; the last range includes its upper edge.
    """
    rows = []
    for low, high in pairwise(edges.tolist()):
        mine = (score >= low) & ((score < high) | (high == edges[-1]) & (score == high))
        count, good = int(mine.sum()), int(right[mine].sum())
        if count:
            rows.append(
                {
                    "from": float(low),
                    "to": float(high),
                    "count": count,
                    "mean_score": float(score[mine].mean()),
                    "right": good / count,
                    "interval": wilson_interval(good, count),
                }
            )
    return rows


def main() -> None:
    files = [Path(name) for name in sys.argv[1:]]
    answers = answers_of([row for file in files for row in json.loads(file.read_text())["each"]])
    numbers = finite(figures(answers) | {"from": [file.name for file in files]})
    (LAB / "perception-calibration.json").write_text(json.dumps(numbers, indent=1) + "\n")
    (LAB / "perception-calibration.svg").write_text(plot(numbers))


if __name__ == "__main__":
    main()
