"""``python -m benchmarks.perception looks``: what further looks at the same grasps add to the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from fungrasp.cli.console import table

if TYPE_CHECKING:
    from benchmarks.perception.verdict_trials import VerdictTrial


@dataclass(frozen=True)
class Looks:
    """Put the verdict's trials of several looks together as ``perceive --frames`` does: another look is taken
    where those before leave doubt. Each file holds one look at the captures, which have the same names."""

    trials: Annotated[list[Path], tyro.conf.Positional]
    """Files of trials that `verdict` wrote, in the order of the looks."""
    json: Path | None = None
    """Write the figures here."""

    def run(self) -> None:
        from benchmarks.perception.verdict_trials import read_trials
        from fungrasp.core.errors import FungraspError
        from fungrasp.core.provenance import run_record
        from fungrasp.evaluation import write_result

        if len(self.trials) < 2:
            raise FungraspError("one file of trials is one look: give two or more")
        figures, rows = looks_figures([read_trials(path)[0] for path in self.trials])
        print(table(looks_rows(figures)))
        if self.json is not None:
            write_result(self.json, run_record(0) | figures, rows)


def looks_figures(
    looks: Sequence[Sequence[VerdictTrial]],
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """What was accepted after the first look and after all of them, and a row for each mesh and capture.

    Args:
        looks: the answers of each look. Only meshes that have one in each count; one whose search found
            nothing has a probability of 0.
    """
    from benchmarks.perception.measurements import rate_of
    from benchmarks.perception.verdict_fit import evidence_of
    from benchmarks.perception.verdict_trials import RIGHT
    from fungrasp.perception.object_pose.confidence import ACCEPT, confidence
    from fungrasp.perception.several_looks import probability_of_looks

    by_key = [{(one.capture, one.told, one.mesh): one for one in answers} for answers in looks]
    rows: list[dict[str, Any]] = []
    for key in by_key[0]:
        if not all(key in answers for answers in by_key):
            continue
        answers = [each[key] for each in by_key]
        said = [confidence(evidence_of(one)) if one.evidence else 0.0 for one in answers]
        taken = next((n for n in range(1, len(said)) if probability_of_looks(said[:n]) >= ACCEPT), len(said))
        surest = max(range(taken), key=lambda i: said[i])
        rows.append(
            dict(zip(("capture", "told", "mesh"), key, strict=True))
            | {f"said_{i + 1}": value for i, value in enumerate(said)}
            | {
                "first_right": answers[0].right,
                "looks": taken,
                "together": probability_of_looks(said[:taken]),
                "right": answers[surest].right,
            }
        )
    figures: dict[str, Any] = {"captures": len({row["capture"] for row in rows}), "looks": len(looks)}
    for told in dict.fromkeys(row["told"] for row in rows):
        mine = [row for row in rows if row["told"] == told]
        figures[told] = {
            name: {
                "first": rate_of(
                    [row["said_1"] >= ACCEPT for row in chosen if name != "right" or row["first_right"]]
                ),
                "together": rate_of(
                    [row["together"] >= ACCEPT for row in chosen if name != "right" or row["right"]]
                ),
            }
            for name, chosen in (
                ("right", [row for row in mine if row["mesh"] == RIGHT]),
                ("wrong_mesh", [row for row in mine if row["mesh"] != RIGHT]),
            )
        }
    return figures, rows


def looks_rows(figures: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The figures as a table."""
    from benchmarks.perception.verdict_figures import counted

    names = {"right": "right answers accepted", "wrong_mesh": "wrong meshes accepted"}
    rows: list[tuple[str, ...]] = [("told", "", "first look", f"{figures['looks']} looks")]
    for told, each in figures.items():
        if isinstance(each, Mapping):
            rows += [
                (told, names[name], counted(rate["first"]), counted(rate["together"]))
                for name, rate in each.items()
            ]
    return rows
