"""``python -m benchmarks.perception verdict``: how sure perception is, against how often it is right."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar, table


@dataclass(frozen=True)
class Verdict:
    """Try the right mesh and wrong ones (other sizes, proportions and objects, mirror images) on captures
    whose truth is known; say how often what is accepted is right, and draw it. Each capture is measured once:
    the evidence lies in a file, out of which the weights of the verdict are fitted in a second."""

    trials: Annotated[Path, tyro.conf.Positional]
    """File of the trials (.jsonl): captures that are in it are not measured again."""
    captures: Path | None = None
    """Folder of captures, such as `varied` renders or `recorded` reads, that are added to it."""
    wrong: int = 3
    """Kinds of wrong meshes that are drawn for each capture; 0 takes all."""
    fit: bool = False
    """Fit the weights to these trials, print them, and judge by them."""
    json: Path | None = None
    """Write the figures here."""
    figure: Path | None = None
    """Draw the reliability diagram here (.svg)."""

    def run(self) -> None:
        from benchmarks.perception.verdict_figures import reliability_svg, verdict_figures, verdict_rows
        from benchmarks.perception.verdict_fit import fitted_weights, written_weights
        from benchmarks.perception.verdict_trials import read_trials
        from fungrasp.core.errors import FungraspError
        from fungrasp.core.provenance import run_record
        from fungrasp.evaluation import write_result

        check_positive(wrong=self.wrong + 1)
        if self.captures is not None:
            self._measure(self.captures)
        if not self.trials.is_file():
            raise FungraspError(f"{self.trials} does not exist: --captures says what to measure")
        answers, hands = read_trials(self.trials)
        fitted = fitted_weights(answers, hands) if self.fit else None
        if fitted is not None:
            print(written_weights(fitted))
        figures = verdict_figures(answers, hands, fitted)
        print(table(verdict_rows(figures)))
        if self.json is not None:
            write_result(self.json, run_record(0) | figures, map(asdict, answers))
        if self.figure is not None:
            self.figure.write_text(reliability_svg(figures), encoding="utf-8")

    def _measure(self, folder: Path) -> None:
        """Add the trials of all captures that are not in the file yet."""
        from benchmarks.perception.recorded_captures import read_recorded, recorded_folders
        from benchmarks.perception.verdict_trials import (
            append_trials,
            measure_trials,
            painted_vertices,
            read_trials,
        )
        from fungrasp.objects import builtin_object, object_names
        from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector

        done = {trial.capture for trial in read_trials(self.trials)[0]} if self.trials.is_file() else set()
        every = list(enumerate(recorded_folders(folder)))
        folders = [(i, path) for i, path in every if path.name not in done]
        detector = MediaPipeHandDetector(threads=1)
        others = {name: builtin_object(name) for name in object_names()}
        with progress_bar("measuring", max(len(folders), 1)) as show:
            for count, (i, path) in enumerate(folders):
                recorded = read_recorded(path)
                # Every second rendered object is known with its colors.
                painted = painted_vertices(path) if i % 2 == 0 else None
                append_trials(
                    self.trials, *measure_trials(recorded, detector, others, self.wrong or None, painted)
                )
                show(count + 1)
