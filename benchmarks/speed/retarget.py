"""``python -m benchmarks.speed retarget``: grasps per second and static quality of each method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.command import check_positive
from fungrasp.cli.console import table, write_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fungrasp.grasps import HumanGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel


@dataclass(frozen=True)
class Retargeting:
    """Measure how many grasps a second each method retargets, and how good they are."""

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    method: tuple[str, ...] = ()
    """Methods to measure; all by default."""
    repeat: int = 3
    """Rounds, of which the fastest counts."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        from fungrasp.core.errors import UnknownNameError
        from fungrasp.core.formats.text_files import finite
        from fungrasp.core.provenance import machine
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.retargeting import METHODS

        check_positive(repeat=self.repeat)
        for name in self.method:
            if name not in METHODS:
                raise UnknownNameError("retargeting method", name, METHODS)
        hand = load_hand(self.hand)
        human = load_human_grasps(self.grasps)
        objects = load_objects(human, self.objects)
        results = {name: self._measure(name, human, objects, hand) for name in self.method or tuple(METHODS)}
        about = {"hand": hand.name, "grasps": len(human), "threads": self.threads, "machine": machine()}
        if self.json is not None:
            write_json(self.json, finite(about | {"methods": results}))
        columns = ("contact_error_mm", "contact_gap_mm", "link_direction_error_deg", "object_penetration_mm")
        head = (
            "method",
            "grasps/s",
            "contact error [mm]",
            "gap [mm]",
            "directions [deg]",
            "penetration [mm]",
        )
        rows = [
            (name, f"{r['grasps_per_second']:.0f}", *(f"{r['quality'][c]['mean']:.2f}" for c in columns))
            for name, r in results.items()
        ]
        print(table([head, *rows]))
        print(f"{len(human)} grasps of {len(objects)} objects; {machine()}")

    def _measure(
        self, method: str, human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
    ) -> dict[str, Any]:
        from time import perf_counter

        from fungrasp.evaluation import static_quality
        from fungrasp.retargeting import retarget

        rates = []
        for _ in range(self.repeat):
            start = perf_counter()
            robot = retarget(human, objects, hand, method, threads=self.threads)
            rates.append(len(human) / (perf_counter() - start))
        quality = static_quality(robot, human, objects, hand)
        return {"grasps_per_second": max(rates), "quality": quality.summary()}
