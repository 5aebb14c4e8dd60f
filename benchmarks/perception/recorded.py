"""``python -m benchmarks.perception recorded``: perception on a set of real captures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fungrasp.cli.console import progress_bar, table


@dataclass(frozen=True)
class Recorded:
    """Measure captures whose truth is known, of a real camera or of `varied`: the object with and without
    hints, and the hand."""

    folder: Annotated[Path, tyro.conf.Positional]
    """One folder each: rgb.png, depth.png, K.json, mask.png, truth.json; `recorded_captures.py` says what is
    in them."""
    json: Path | None = None
    """Write the numbers here (.json), each answer to a CSV file beside it."""

    def run(self) -> None:
        report_recorded(self.folder, self.json)


def report_recorded(folder: Path, json: Path | None) -> None:
    """Measure every capture in a folder, print the figures and write them.

    Args:
        folder: the validation set, see ``recorded_captures``.
        json: file for the numbers, if wanted; each answer is in a CSV file beside it.

    Raises:
        FungraspError: there are no captures, or one can't be read.
    """
    from benchmarks.perception.recorded_captures import read_recorded, recorded_folders
    from benchmarks.perception.recorded_figures import (
        measure_recorded,
        recorded_figures,
        recorded_rows,
        recorded_table,
    )
    from fungrasp.core.provenance import machine, run_record
    from fungrasp.evaluation import write_result
    from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector

    folders, detector = recorded_folders(folder), MediaPipeHandDetector()
    results = []
    with progress_bar("perceiving", len(folders)) as show:
        for i, path in enumerate(folders):
            results.append(measure_recorded(read_recorded(path), detector))
            show(i + 1)
    figures = recorded_figures(results)
    if json is not None:
        write_result(json, run_record(0) | {"folder": folder.name} | figures, recorded_rows(results))
    each = [("capture", "told", "ADD-S [mm]", "turned [deg]", "score", "accepted", "[s]")]
    for result in results:
        for answer in result.objects:
            each.append(
                (
                    result.name,
                    answer.hint,
                    f"{answer.add_s_mm:.1f}",
                    f"{answer.rotation_deg:.0f}",
                    f"{answer.score:.2f}",
                    "yes" if answer.accepted else "no",
                    f"{answer.seconds:.2f}",
                )
            )
    if len(each) > 1:
        print(table(each, left=(0, 1)))
        print(table(recorded_table(figures)))
    hand = figures["hand"]
    if hand["found"] is not None:
        found = hand["found"]
        print(
            f"hand found in {round(found['rate'] * found['count'])} of {found['count']}, landmarks "
            f"{_number(hand['pixel_error'])} px, joints {_number(hand['joint_error_mm'])} mm (medians)"
        )
    none = figures["no_hand_sure"]
    if none is not None:
        print(
            f"sure of a hand in {round(none['rate'] * none['count'])} of {none['count']} captures without one"
        )
    plane = figures["table"]
    if plane["angle_deg"] is not None:
        print(
            f"table: {plane['angle_deg']:.1f} deg, {_number(plane['height_mm'])} mm at the object (medians)"
        )
    print(f"{len(results)} captures; hand and table {_number(hand['seconds'])} s (median); {machine()}")


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.1f}"
