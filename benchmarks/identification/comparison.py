"""``python -m benchmarks.identification``: identification against known dynamics and a real step response."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from fungrasp.cli.console import table


@dataclass(frozen=True)
class BenchIdentify:
    """Fit dynamics that are known, Gauss-Newton and CMA-ES, a real hand's step response where there is one,
    and hands of twins whose dynamics are drawn."""

    trials: int = 3
    """Truths."""
    finger: str = "index"
    """Of the Allegro hand."""
    method: tuple[str, ...] = ("gauss-newton", "cma-es")
    """Methods."""
    evaluations: int = 1000
    """Simulations of cma-es."""
    step: Path | None = None
    """Step response of an Inspire hand (.csv)."""
    twins: int = 0
    """Twins of each robot."""
    robots: tuple[str, ...] = ("ur5e-allegro", "ur5e-inspire")
    """Cells that are twins."""
    weight: float = 0.0
    """Mass that is fixed to each fingertip of twins in as many logs more [kg]."""
    json: Path | None = None
    """Write the numbers here (.json, with a .csv beside)."""

    def run(self) -> None:
        from benchmarks.identification.drawn_twins import twin_fit
        from benchmarks.identification.known_truth import known_truth_fit, step_fit
        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation.result_files import write_result
        from fungrasp.hands import load_hand
        from fungrasp.objects import load_object
        from fungrasp.robots.cell import load_cell

        allegro, inspire = load_hand("allegro"), load_hand("inspire")
        rows: list[dict] = []
        for method in self.method:
            for seed in range(self.trials):
                fit = known_truth_fit(allegro, self.finger, method, seed, self.evaluations)
                rows.append({"log": "known truth", **asdict(fit)})
            if self.step is not None:
                found = step_fit(inspire, self.step, "index_proximal_joint", method, self.evaluations)
                rows.append({"log": "real step", **asdict(found)})
            for name in self.robots if self.twins else ():
                cell = load_cell(name)
                hand, thing = load_hand(cell.hand), load_object("wine_glass")
                for twin in range(self.twins):
                    drawn = twin_fit(cell, hand, thing, twin, method, self.evaluations, self.weight)
                    rows.append({"log": "drawn twin", **asdict(drawn)})
            if self.json is not None:
                write_result(self.json, run_record(0), rows)
        names = list(dict.fromkeys(name for row in rows for name in row))
        print(table([names, *([_text(row.get(name)) for name in names] for row in rows)]))
        print(machine())


def _text(value: object) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


COMMAND = BenchIdentify
