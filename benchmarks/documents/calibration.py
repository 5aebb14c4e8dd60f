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
from fungrasp.plots import PlotLine, PlotPanel, panels_svg

LAB = Path(__file__).parents[2] / "docs" / "lab"
EDGES = np.array([0.0, 0.1, 0.25, 0.5, ACCEPT, 0.9, 0.97, 1.0])
"""Ranges of scores."""


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

    rows = numbers["ranges"]
    score, right = (np.array([row[name] for row in rows]) for name in ("mean_score", "right"))
    ends = np.array([row["interval"] for row in rows])
    gap = np.full(len(rows), np.nan)
    bars = PlotLine(
        np.column_stack([score, score, gap]).ravel(), np.column_stack([ends, gap]).ravel(), "95 % interval"
    )
    lines = [
        PlotLine(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "as it should be", "#bbbbbb", "--"),
        PlotLine(np.array([ACCEPT, ACCEPT]), np.array([0.0, 1.0]), "accepted from here on", "#cc6600"),
        bars,
        PlotLine(score, right, "part that is right", "#2277cc", "o"),
    ]
    title = f"{numbers['answers']} answers; in the ranges {', '.join(str(row['count']) for row in rows)}"
    return panels_svg([PlotPanel(title, "score", "part right", lines, limits=(0.0, 1.02))], width=6, height=4)


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
