"""``python -m benchmarks.peers``: this package's retargeting beside that of others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from benchmarks.peers.comparison import MethodResult

HEAD = (
    "method",
    "grasps/CPU-s",
    "contact error, gap [mm]",
    "object/table/self [mm]",
    "object p95",
    "direction [deg]",
    "success (contact)",
    "without adaptation",
)
"""Columns of the table."""


@dataclass(frozen=True)
class Peers:
    """Retarget with this package and with the others that are installed (dex-retargeting, dexi-rs, mink:
    extra "bench"); compare speed, by processor time on one thread, static quality and lifted objects."""

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    method: tuple[str, ...] = ()
    """Methods and packages to measure; all by default."""
    lift: bool = False
    """Lift the objects too, by the reference controller, with and without adaptation of the grasps to the
    settled object."""
    threads: int = 0
    """Threads of the lifts; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json), one row per grasp in a CSV file beside it."""

    def run(self) -> None:
        compare_with_peers(self)


def compare_with_peers(options: Peers) -> None:
    """Run, print and write the comparison.

    Raises:
        FungraspError: bad options, or a file can't be read or written.
    """
    import sys

    from benchmarks.peers.comparison import PEERS, compare_method, installed_peers
    from fungrasp.core.errors import FungraspError, UnknownNameError
    from fungrasp.core.provenance import machine, run_record
    from fungrasp.grasps import load_human_grasps, load_objects
    from fungrasp.hands import load_hand
    from fungrasp.retargeting import METHODS

    there = installed_peers()
    for name in options.method:
        if name not in (*METHODS, *PEERS):
            raise UnknownNameError("retargeting method", name, (*METHODS, *PEERS))
    names = options.method or (*METHODS, *there)
    hand = load_hand(options.hand)
    human = load_human_grasps(options.grasps)
    objects = load_objects(human, options.objects)
    results: dict[str, MethodResult] = {}
    for name in names:
        if name in PEERS and name not in there:
            raise FungraspError(f"{name} is not installed: pip install 'fungrasp[bench]'")
        try:
            results[name] = compare_method(name, human, objects, hand, options.lift, options.threads)
        except ImportError as error:
            print(f"{name} is installed, but can't be imported: {error}", file=sys.stderr)
            continue
        print(f"{name}: {results[name].grasps_per_cpu_second:.1f} grasps per CPU second", file=sys.stderr)
        if options.json is not None:
            _write(options.json, results, run_record(0) | {"hand": hand.name, "grasps": len(human)})
    print(table([HEAD, *(_row(name, result) for name, result in results.items())]))
    print(f"{len(human)} grasps of {len(objects)} objects by {hand.name}; {machine()}")


def _row(name: str, result: MethodResult) -> tuple[str, ...]:
    q = result.quality.summary()
    mean = {key: value["mean"] for key, value in q.items()}
    depths = "/".join(f"{mean[f'{what}_penetration_mm']:.1f}" for what in ("object", "table", "self"))
    tests = (result.adapted, result.as_given)
    lifted = [
        "-"
        if test is None
        else f"{100 * test.outcomes.success.mean():.1f} ({100 * test.outcomes.contact_ratio.mean():.0f})"
        for test in tests
    ]
    return (
        name,
        f"{result.grasps_per_cpu_second:.1f}",
        f"{mean['contact_error_mm']:.1f}, {mean['contact_gap_mm']:.1f}",
        depths,
        f"{q['object_penetration_mm']['p95']:.1f}",
        f"{mean['link_direction_error_deg']:.0f}",
        *lifted,
    )


def _write(path: Path, results: Mapping[str, MethodResult], about: Mapping[str, Any]) -> None:
    """One row for each method and grasp."""
    from dataclasses import fields

    import numpy as np

    from fungrasp.evaluation.result_files import write_result

    rows = []
    for name, result in results.items():
        numbers = {f.name: getattr(result.quality, f.name) for f in fields(result.quality)}
        tests = {"adapted": result.adapted, "as_given": result.as_given}
        for row in range(len(result.robot)):
            entry: dict[str, Any] = {"method": name, "object": str(result.robot.object_name[row])}
            for key, values in numbers.items():
                entry[key] = round(float(values[row]), 4) if np.isfinite(values[row]) else None
            for key, test in tests.items():
                if test is not None:
                    entry[f"{key}_success"] = bool(test.outcomes.success[row])
                    entry[f"{key}_contact_ratio"] = round(float(test.outcomes.contact_ratio[row]), 4)
            rows.append(entry)
    speeds = {name: round(result.grasps_per_cpu_second, 1) for name, result in results.items()}
    write_result(path, {"grasps_per_cpu_second": speeds, **about}, rows)


COMMAND = Peers
