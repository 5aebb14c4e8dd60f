"""``python -m benchmarks.speed planning``: what it costs to plan a grasp."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar, table, write_json


@dataclass(frozen=True)
class BenchPlanning:
    """Measure the processor time that `plan` takes for a grasp: settling, candidates, success predictor,
    rollouts. Time of all threads counts, and waiting for a processor does not."""

    grasps: str = "builtin"
    """A file of human or of robot grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    policy: str = "student"
    """Whose plans they are, as for `fungrasp evaluate`."""
    protocol: Literal["nominal", "reality"] = "nominal"
    """What rollouts draw from."""
    number: int = 24
    """Grasps to plan, evenly spread over the file."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        from time import process_time

        import numpy as np

        from fungrasp.core.provenance import machine
        from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
        from fungrasp.planning import plan
        from fungrasp.retargeting import retarget

        check_positive(number=self.number)
        grasps = load_grasps(self.grasps)
        some = grasps.select(np.unique(np.linspace(0, len(grasps) - 1, self.number).astype(int)))
        objects = load_objects(some, self.objects)
        if not isinstance(some, RobotGraspSet):
            some = retarget(some, objects, self.hand, threads=self.threads)
        seconds = {}
        for name, rollouts in (("with rollouts", True), ("predictor alone", False)):
            with progress_bar(name, len(some)) as show:
                start = process_time()
                plans = plan(
                    some,
                    objects,
                    self.policy,
                    protocol=self.protocol,
                    rollouts=rollouts,
                    threads=self.threads,
                    progress=show,
                )
            tried = 0.0 if plans.rollouts is None else float(plans.rollouts.mean())
            expected = None if plans.expected_success is None else float(plans.expected_success.mean())
            seconds[name] = {
                "seconds_per_grasp": (process_time() - start) / len(some),
                "rollouts_per_grasp": tried,
                "expected_success": expected,
            }
        if self.json is not None:
            about = {
                "hand": some.hand,
                "policy": self.policy,
                "protocol": self.protocol,
                "machine": machine(),
            }
            write_json(self.json, about | {"grasps": len(some), "planning": seconds})
        head = ("planning", "core seconds per grasp", "rollouts per grasp", "expected success")
        lines = [
            (
                name,
                f"{value['seconds_per_grasp']:.2f}",
                f"{value['rollouts_per_grasp']:.0f}",
                "" if value["expected_success"] is None else f"{value['expected_success']:.0%}",
            )
            for name, value in seconds.items()
        ]
        print(table([head, *lines]))
        print(f"{len(some)} grasps of {len(objects)} objects; {machine()}")
