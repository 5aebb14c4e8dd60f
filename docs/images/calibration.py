"""Makes docs/perception-calibration.json and its plot from what ``fungrasp bench perception --json`` wrote.

``python docs/images/calibration.py BENCH.json [BENCH.json ...]`` takes the answers of several runs together.
``--fit`` also fits the score's weights anew, checks them on objects that each fit has not seen, and prints
them; they are put into ``perception/pose_confidence.py`` by hand.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.evaluation.calibration import (
    Answers,
    answers_of,
    cross_validated,
    fit_logistic,
    log_loss,
    lowest_threshold,
    reliability,
)
from fungrasp.evaluation.results import finite
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.perception.object_pose.confidence import ACCEPT, FEATURES

HERE = Path(__file__).parent
EDGES = np.array([0.0, 0.1, 0.25, 0.5, ACCEPT, 0.9, 0.97, 1.0])
"""Ranges of scores."""

SIZE, LEFT, TOP = 300, 60, 20
"""Of the plot [pixels]: edge of the square, space to its left and above."""


def figures(answers: Answers) -> dict[str, Any]:
    """What the score was worth."""
    accepted = answers.score >= ACCEPT
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
        "log_loss": log_loss(answers.score, answers.right),
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


def refit(answers: Answers) -> None:
    """Print new weights, and what they are worth on objects they have not seen."""
    choices = {
        "today's": [FEATURES.index(name) for name in ("explained", "contradicted", "visible", "pixels")],
        "and the rival": [0, 1, 2, 3, 4],
        "all": list(range(len(FEATURES))),
    }
    for words, columns in choices.items():
        score = cross_validated(answers, columns)
        threshold = lowest_threshold(score, answers.right)
        kept = score >= threshold
        weights = fit_logistic(answers.evidence[:, columns], answers.right)
        sys.stdout.write(
            f"{words}: log loss {log_loss(score, answers.right):.3f} on objects not seen; from "
            f"{threshold:.2f} on 97 % are right, {kept.sum()} of {len(kept)}; "
            f"{[FEATURES[c] for c in columns]} {np.round(weights, 2).tolist()}\n"
        )


def main() -> None:
    files = [Path(name) for name in sys.argv[1:] if name != "--fit"]
    answers = answers_of([row for file in files for row in json.loads(file.read_text())["each"]])
    numbers = finite(figures(answers) | {"from": [file.name for file in files]})
    if "--fit" in sys.argv:
        refit(answers)
        return
    (HERE.parent / "perception-calibration.json").write_text(json.dumps(numbers, indent=1) + "\n")
    (HERE / "perception-calibration.svg").write_text(plot(numbers))


if __name__ == "__main__":
    main()
