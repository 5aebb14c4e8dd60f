"""Methods of retargeting side by side: the same human grasps, retargeted by each and tried alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import PartStore, RayCluster
from fungrasp.evaluation.lift_evaluation import LiftTestResult, evaluate
from fungrasp.evaluation.lift_test_spec import LiftTestSpec
from fungrasp.evaluation.result_files import save_result
from fungrasp.evaluation.result_tables import comparison_table
from fungrasp.evaluation.results import result_json, result_record, summary
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import METHODS, method_name, retarget


@dataclass(frozen=True, eq=False)
class MethodComparison:
    """Results by the name of the method."""

    grasps: Mapping[str, RobotGraspSet]
    """What retargeting gave."""
    results: Mapping[str, LiftTestResult]
    """As they were asked for."""
    without_adaptation: Mapping[str, LiftTestResult]
    """Where the planner does not fit the grasps to the object as it has settled, which repairs much of what
    retargeting leaves wrong; empty where it does not anyway, and where there are several conditions."""
    seconds: float
    """Time that it took [s]."""

    @property
    def episodes(self) -> int:
        """Number of all episodes."""
        return sum(
            result.episodes for each in (self.results, self.without_adaptation) for result in each.values()
        )

    def table(self) -> str:
        """The table of each result, then methods side by side."""
        parts = [f"{name}:\n{result.table()}" for name, result in self.results.items()]
        parts.append(comparison_table(self.results))
        if self.without_adaptation:
            words = "without adaptation to the settled object:"
            parts += [words, comparison_table(self.without_adaptation)]
        return "\n".join(parts)

    def json(self) -> dict[str, Any]:
        """All numbers, and what ran where."""
        methods = {name: result_json(result) for name, result in self.results.items()}
        for name, result in self.without_adaptation.items():
            methods[name]["without_adaptation"] = summary(result)
        return result_record({"methods": methods}, self.seconds)

    def save(self, path: str | Path, compact: bool = False) -> None:
        """Write all numbers, as ``LiftTestResult.save`` does."""
        save_result(path, self.json(), compact)


def compare_methods(
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand | str,
    methods: tuple[str, ...] = tuple(METHODS),
    *,
    spec: LiftTestSpec | None = None,
    record: Path | None = None,
    threads: int = 0,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> MethodComparison:
    """Retarget human grasps by several methods, and try what each gives.

    Args:
        human: the grasps.
        objects: by name.
        hand: the robot hand, its name, or the path of its TOML file.
        methods: of ``fungrasp.retargeting.METHODS``.
        spec: what is asked; the defaults if None.
        record: folder in which each method has one for its recorded episodes.
        threads: 0 means all processors.
        store: keeps finished parts of the lift tests; who calls removes it.
        ray: simulates on a cluster.
        progress: called with the share that is done, 0 to 1.

    Raises:
        FungraspError: as ``retarget`` and ``evaluate``, or a method twice.
    """
    hand, spec, names = as_hand(hand), spec or LiftTestSpec(), tuple(map(method_name, methods))
    if not names or len(set(names)) < len(names):
        raise FungraspError("--method needs at least one value, and each once")
    plain = replace(spec, adapt=False, static=False) if spec.adapt and len(spec.conditions) == 1 else None
    start, done, whole = perf_counter(), 0, len(names) * (1 if plain is None else 2)
    grasps: dict[str, RobotGraspSet] = {}
    found: dict[bool, dict[str, LiftTestResult]] = {True: {}, False: {}}
    for name in names:
        robot = grasps[name] = retarget(human, objects, hand, name, threads=threads)
        for asked in (spec, plain):
            if asked is None:
                continue
            folder = None if record is None else record / name
            if folder is not None and asked is plain:
                folder /= "without-adaptation"
            found[asked is spec][name] = evaluate(
                robot,
                objects,
                spec=asked,
                hand=hand,
                human=human,
                record=folder,
                threads=threads,
                store=store,
                ray=ray,
                progress=lambda share, before=done: progress((before + share) / whole),
            )
            done += 1
    return MethodComparison(grasps, found[True], found[False], perf_counter() - start)
