"""``python -m benchmarks.peers``: this package's retargeting beside that of others: same grasps, same hand,
same judge."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.mink_solver import solve_mink
from benchmarks.peers.position_solvers import solve_dex_retargeting, solve_dexi
from benchmarks.peers.problem import CpuClock, PeerProblem
from fungrasp.cli.console import table
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.provenance import machine, run_record
from fungrasp.evaluation import LiftTestResult, evaluate
from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
from fungrasp.evaluation.result_files import write_result
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, load_human_grasps, load_objects
from fungrasp.grasps.as_shown import with_shown_places
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionSettings, make_planner
from fungrasp.retargeting import METHODS, retarget

Solve = Callable[[PeerProblem], tuple[RobotGraspSet, float]]

PEERS: Mapping[str, tuple[str, Solve]] = {
    "dex-retargeting": ("dex_retargeting", solve_dex_retargeting),
    "dexi-rs": ("dexi_rs", solve_dexi),
    "mink": ("mink", solve_mink),
}
"""Module that must be installed, and how the peer solves. pyroki is not on PyPI, and has no entry."""

ROUNDS = 3
"""Rounds of this package's methods, of which the fastest counts, as other processes disturb short ones."""


@dataclass(frozen=True)
class MethodResult:
    """One method's grasps."""

    robot: RobotGraspSet
    """The grasps."""
    cpu_seconds: float
    """Processor time of the solving alone, one thread: no imports, compiling or reading of files."""
    quality: StaticQuality
    """By the judge for all methods."""
    adapted: LiftTestResult | None = None
    """Lift test by the reference controller; the planner fits each grasp to the settled object."""
    as_given: LiftTestResult | None = None
    """The same without that."""

    @property
    def grasps_per_cpu_second(self) -> float:
        """Speed."""
        return len(self.robot) / self.cpu_seconds


def installed_peers() -> list[str]:
    """Names of the peers whose packages are there."""
    return [name for name, (module, _) in PEERS.items() if find_spec(module) is not None]


def compare_method(
    name: str,
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    lift: bool = False,
    threads: int = 0,
) -> MethodResult:
    """Solve and judge by one method.

    Args:
        name: of ``fungrasp.retargeting.METHODS`` or ``PEERS``.
        human: the grasps.
        objects: by name.
        hand: the robot hand.
        lift: lift the objects too, with and without adaptation.
        threads: of the lift test.
    """
    for model in objects.values():
        _ = model.signed_distance
    if name in METHODS:
        robot, seconds = _own(name, human, objects, hand)
    else:
        robot, seconds = PEERS[name][1](PeerProblem.of(human, objects, hand))
        robot = with_shown_places(robot, human, objects, hand)
    quality = static_quality(robot, human, objects, hand)
    if not lift:
        return MethodResult(robot, seconds, quality)
    lifted = [
        evaluate(
            robot,
            objects,
            hand=hand,
            plans=make_planner("reference", hand, objects, motions=motions, threads=threads),
            threads=threads,
        )
        for motions in (None, MotionSettings(adapt=None))
    ]
    return MethodResult(robot, seconds, quality, *lifted)


def _own(
    name: str, human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
) -> tuple[RobotGraspSet, float]:
    robot = retarget(human, objects, hand, name, threads=1)
    seconds = []
    for _ in range(ROUNDS):
        with CpuClock() as clock:
            robot = retarget(human, objects, hand, name, threads=1)
        seconds.append(clock.seconds)
    return robot, min(seconds)


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
        there = installed_peers()
        for name in self.method:
            if name not in (*METHODS, *PEERS):
                raise UnknownNameError("retargeting method", name, (*METHODS, *PEERS))
        names = self.method or (*METHODS, *there)
        hand = load_hand(self.hand)
        human = load_human_grasps(self.grasps)
        objects = load_objects(human, self.objects)
        results: dict[str, MethodResult] = {}
        for name in names:
            if name in PEERS and name not in there:
                raise FungraspError(f"{name} is not installed: pip install 'fungrasp[bench]'")
            try:
                results[name] = compare_method(name, human, objects, hand, self.lift, self.threads)
            except ImportError as error:
                print(f"{name} is installed, but can't be imported: {error}", file=sys.stderr)
                continue
            print(f"{name}: {results[name].grasps_per_cpu_second:.1f} grasps per CPU second", file=sys.stderr)
            if self.json is not None:
                _write(self.json, results, run_record(0) | {"hand": hand.name, "grasps": len(human)})
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
                    entry[f"{key}_held_as_shown"] = bool(test.outcomes.held_as_shown[row])
                    entry[f"{key}_contact_ratio"] = round(float(test.outcomes.contact_ratio[row]), 4)
            rows.append(entry)
    speeds = {name: round(result.grasps_per_cpu_second, 1) for name, result in results.items()}
    write_result(path, {"grasps_per_cpu_second": speeds, **about}, rows)


COMMAND = Peers
