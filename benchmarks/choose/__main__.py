"""``python -m benchmarks.choose``: two variants on the same grasps and worlds."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from benchmarks.command import check_positive, main
from fungrasp.cli.console import table
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import read_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.choose.pairing import PairedMeans, PairedRates

USES = Path(__file__).resolve().parents[2] / "lab" / "confirm-uses.csv"
"""Where the uses of the part "test" are recorded."""

LARGEST = 1_000_000
"""Bytes of the largest record that is read."""

COLUMNS = ("date", "decision", "a", "b", "grasps", "a_percent", "b_percent", "low", "high")


@dataclass(frozen=True)
class Choose:
    """Compare two variants on the same grasps and worlds: the difference of what they lift, with its 95 %
    interval, by kind of object.

    A variant is METHOD[,SECTION.FIELD=VALUE...]: a method of retargeting (contact, angle-copy, dexgraspnet,
    or a peer: mink, dexi-rs, dex-retargeting) and settings, of retargeting (retarget.gap_unit=0.002), of
    the planned motion (motion.press_in=0), of the lift test (lift.adapt=false, lift.policy=plan,
    lift.protocol=reality). With CHECKOUT:: before it, the package of that checkout is measured. What was
    measured before, with the same program, is not measured again."""

    first: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")]
    """A variant."""
    second: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")]
    """The variant whose gain over A is asked."""
    set: Path
    """Folder of a set, made by 'python -m benchmarks.grasp_set'."""
    part: Literal["train", "validation", "test"] = "validation"
    """Part of the set: "choose" for decisions; "confirm" once for each, recorded in lab."""
    decision: str = ""
    """What is decided: needed for the part "test"."""
    every: int = 1
    """Only every so manieth grasp, of each object."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    threads: int = 0
    """0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json), one row per grasp in a CSV file beside it."""
    uses: Path = USES
    """File of the uses of the part "test"."""

    def run(self) -> None:
        import numpy as np

        from benchmarks.choose.measurement import MeasurementRequest
        from benchmarks.choose.pairing import paired_means, paired_rates
        from benchmarks.choose.variant import Variant
        from benchmarks.grasp_set.parts import load_part
        from fungrasp.cli.console import progress_bar
        from fungrasp.core.errors import FungraspError

        check_positive(every=self.every)
        if self.part == "test" and not self.decision:
            raise FungraspError("the part 'test' is for decisions: say which with --decision 'WORDS'")
        for text in (self.first, self.second):
            Variant.parse(text)
        part = load_part(self.set, self.part)
        found = []
        with progress_bar("measuring", 2.0) as show:
            for number, text in enumerate((self.first, self.second)):
                request = MeasurementRequest(
                    text,
                    str(self.set),
                    self.part,
                    self.every,
                    self.hand,
                    self.threads,
                    str(self.set / "measured"),
                )
                found.append(request.measure(lambda done, before=number: show(before + done)))
        rows = np.arange(0, len(part.grasps), self.every)
        names, stratum = part.grasps.object_name[rows], part.stratum[rows]
        first, second = found
        rates, means = paired_rates(first, second, names, stratum), paired_means(first, second, names)
        print(f"A: {self.first}\nB: {self.second}\n{_rates_table(rates)}\n\n{_means_table(means)}")
        print(f"{len(rows)} grasps of part '{self.part}', {self.hand}")
        if self.part == "test":
            count = record_use(self.uses, self.decision, self.first, self.second, rates[-1])
            print(f"use {count} of the part 'test', recorded in {self.uses}")
        if self.json is not None:
            self._write(rates, means, names.tolist(), stratum.tolist(), found)

    def _write(
        self,
        rates: Sequence[PairedRates],
        means: Sequence[PairedMeans],
        names: list[str],
        strata: list[str],
        found: list[dict[str, Any]],
    ) -> None:
        """Summary, and one row for each grasp."""
        from dataclasses import asdict

        import numpy as np

        from fungrasp.core.provenance import run_record
        from fungrasp.evaluation.result_files import write_result

        rows = []
        for number, (name, stratum) in enumerate(zip(names, strata, strict=True)):
            row: dict[str, Any] = {"object": name, "stratum": stratum}
            for side, arrays in zip("ab", found, strict=True):
                for key, values in arrays.items():
                    value = values[number].item()
                    finite = isinstance(value, bool) or np.isfinite(value)
                    row[f"{side}_{key}"] = (
                        value if isinstance(value, bool) else round(value, 4) if finite else None
                    )
            rows.append(row)
        header = {"a": self.first, "b": self.second, "part": self.part, "hand": self.hand}
        header |= {"rates": [asdict(rate) for rate in rates], "means": [asdict(mean) for mean in means]}
        assert self.json is not None
        write_result(self.json, {**header, **run_record(0)}, rows)


def record_use(path: Path, decision: str, first: str, second: str, rate: PairedRates) -> int:
    """Add a line to the record.

    Args:
        path: of the record (.csv); it is begun where there is none.
        decision: what is decided.
        first: the variant A.
        second: the variant B.
        rate: of all grasps; the interval is that of B less A, in points.

    Returns:
        how often the part was used, this time included.

    Raises:
        FungraspError: the file can't be read or written.
    """
    before = ",".join(COLUMNS) + "\n"
    if path.is_file():
        before = read_bytes(path, "record of uses", LARGEST).decode()
    line = io.StringIO()
    numbers = (rate.first, rate.second, *rate.interval)
    percent = [f"{100 * value:.1f}" for value in numbers]
    date = f"{datetime.now().astimezone():%Y-%m-%d %H:%M%z}"
    csv.writer(line, lineterminator="\n").writerow([date, decision, first, second, rate.grasps, *percent])
    text = before + line.getvalue()
    with atomic_path(path) as temporary:
        temporary.write_text(text)
    return len(list(csv.reader(io.StringIO(text)))) - 1


def _rates_table(rates: Sequence[PairedRates]) -> str:
    rows = [("objects", "grasps", "of objects", "A", "B", "B - A [points]", "95 % interval", "only A, B")]
    rows += [
        (
            rate.stratum,
            str(rate.grasps),
            str(rate.objects),
            f"{100 * rate.first:.1f} %",
            f"{100 * rate.second:.1f} %",
            f"{100 * (rate.second - rate.first):+.1f}",
            f"{100 * rate.interval[0]:+.1f} to {100 * rate.interval[1]:+.1f}",
            f"{rate.only_first}, {rate.only_second}",
        )
        for rate in rates
    ]
    return table(rows)


def _means_table(means: Sequence[PairedMeans]) -> str:
    rows = [("mean", "A", "B", "B - A", "95 % interval")]
    rows += [
        (
            mean.name,
            f"{mean.first:.2f}",
            f"{mean.second:.2f}",
            f"{mean.second - mean.first:+.2f}",
            f"{mean.interval[0]:+.2f} to {mean.interval[1]:+.2f}",
        )
        for mean in means
    ]
    return table(rows)


COMMAND = Choose


if __name__ == "__main__":
    main("choose", COMMAND)
