"""``python -m benchmarks.perception``: perception on captures whose truth is known, recorded or rendered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar, table


@dataclass(frozen=True)
class Rendered:
    """Render captures with the errors of real cameras, left hands and hands of other sizes, for
    `recorded`."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Where each gets a folder; those that are there already are not rendered again."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    captures: int = 20
    """How many to render."""
    camera: str = "mixed"
    """One of `DEPTH_CAMERAS`, or "mixed"."""
    hover_mm: tuple[float, float] | None = None
    """Least and largest gap between hand and object [mm], for captures in which nothing is held."""
    seed: int = 1000
    """Decides the captures."""

    def run(self) -> None:
        from benchmarks.perception.capture_files import render_set
        from benchmarks.synthetic_captures.capture_settings import camera_settings
        from fungrasp.grasps import load_human_grasps, load_objects

        check_positive(captures=self.captures)
        human = load_human_grasps(self.grasps)
        hover = None if self.hover_mm is None else (1e-3 * self.hover_mm[0], 1e-3 * self.hover_mm[1])
        objects, settings = load_objects(human, self.objects), camera_settings(self.camera, hover)
        with progress_bar("rendering", self.captures) as show:
            for i in range(self.captures):
                render_set(self.folder, human, objects, i, self.seed, settings)
                show(i + 1)


@dataclass(frozen=True)
class Recorded:
    """Measure captures whose truth is known: the object with and without hints, the hand, what is accepted,
    and lifts of the true object in its true place."""

    folder: Annotated[Path, tyro.conf.Positional]
    """One folder each: rgb.png, depth.png, K.json, mask.png, truth.json; `recorded_captures.py` says what is
    in them."""
    wrong: bool = False
    """Count wrong meshes that are accepted, too: other sizes, other proportions, another object."""
    lift_with: str | None = None
    """Robot hand to which what was perceived without a hint is retargeted, to lift the object."""
    policy: str = "reference"
    """What moves it."""
    json: Path | None = None
    """Write the numbers here (.json), each answer to a CSV file beside it."""

    def run(self) -> None:
        from benchmarks.perception.recorded_captures import read_recorded, recorded_folders
        from benchmarks.perception.recorded_figures import (
            RecordedResult,
            lifted,
            measure_recorded,
            recorded_figures,
            recorded_rows,
            recorded_table,
        )
        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation import write_result
        from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector

        folders, detector = recorded_folders(self.folder), MediaPipeHandDetector()
        results: list[RecordedResult] = []
        lifts: list[bool] = []
        with progress_bar("perceiving", len(folders)) as show:
            for i, path in enumerate(folders):
                recorded = read_recorded(path)
                results.append(measure_recorded(recorded, detector, wrong=self.wrong))
                if self.lift_with is not None and results[-1].objects:
                    lifts.append(lifted(recorded, detector, self.lift_with, self.policy))
                show(i + 1)
        figures = recorded_figures(results, lifts)
        if self.json is not None:
            write_result(
                self.json, run_record(0) | {"folder": self.folder.name} | figures, recorded_rows(results)
            )
        each = [("capture", "hint", "ADD-S [mm]", "turned [deg]", "score", "accepted", "[s]")]
        for result in results:
            each += [
                (
                    result.name,
                    answer.hint,
                    f"{answer.add_s_mm:.1f}",
                    f"{answer.rotation_deg:.0f}",
                    f"{answer.score:.2f}",
                    "yes" if answer.accepted else "no",
                    f"{answer.seconds:.2f}",
                )
                for answer in result.objects
            ]
        if len(each) > 1:
            print(table(each, left=(0, 1)))
            print(table(recorded_table(figures)))
        _print_rest(figures)
        print(f"{len(results)} captures; {machine()}")


def _print_rest(figures: dict[str, Any]) -> None:
    hand, plane = figures["hand"], figures["table"]
    if hand["found"] is not None:
        print(
            f"hand found in {_counted(hand['found'])}, landmarks {_number(hand['pixel_error'])} px, joints "
            f"{_number(hand['joint_error_mm'])} mm (medians)"
        )
    if plane["angle_deg"] is not None:
        print(
            f"table: {plane['angle_deg']:.1f} deg, {_number(plane['height_mm'])} mm at the object (medians)"
        )
    for name, words in (
        ("no_hand_sure", "sure of a hand in captures without one"),
        ("hovering_sure", "sure of a hand that holds nothing"),
        ("wrong_meshes_accepted", "wrong meshes accepted"),
        ("lifted", "lifted"),
    ):
        if figures[name] is not None:
            print(f"{words}: {_counted(figures[name])}")


def _counted(rate: dict[str, Any]) -> str:
    return f"{round(rate['rate'] * rate['count'])} of {rate['count']}"


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.1f}"
