"""``python -m benchmarks.speed planning``: what it costs to plan a grasp."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fungrasp.cli.console import progress_bar, table, write_json


@dataclass(frozen=True)
class BenchPlanning:
    """Measure the processor time that it takes to plan a grasp: candidates, success predictor, rollouts. Time
    of all threads counts, and waiting for a processor does not."""

    grasps: str = "builtin"
    """A file of human or of robot grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    policy: str = "student"
    """Whose plans they are, as for `fungrasp evaluate`."""
    protocol: Literal["nominal", "reality"] = "nominal"
    """What rollouts draw from, and how sure the object's pose is."""
    number: int = 24
    """Grasps to plan, evenly spread over the file."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        from time import process_time

        import numpy as np

        from fungrasp.errors import FungraspError
        from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.objects import with_sizes
        from fungrasp.planning.selection import SelectionSettings
        from fungrasp.policies import make_planner
        from fungrasp.provenance import machine
        from fungrasp.retargeting import retarget
        from fungrasp.sim2real import draw_each, protocol_conditions
        from fungrasp.simulation import build_scene
        from fungrasp.task import LiftEnvironment

        if self.number < 1:
            raise FungraspError(f"--number must be at least 1, not {self.number}")
        hand, grasps = load_hand(self.hand), load_grasps(self.grasps)
        rows = np.unique(np.linspace(0, len(grasps) - 1, self.number).astype(int))
        some = grasps.select(rows)
        objects = load_objects(some, self.objects)
        if not isinstance(some, RobotGraspSet):
            some = retarget(some, objects, hand, threads=self.threads)
        (randomization,) = protocol_conditions(self.protocol).values()
        scene = build_scene(hand, with_sizes(objects, randomization.object_scales))
        environment = LiftEnvironment(scene, len(some), randomization, threads=self.threads)
        belief = environment.settle(some, draw_each(randomization, 0, rows, len(hand.joint_names)))
        seconds = {}
        for name, rollouts in (("with rollouts", True), ("predictor alone", False)):
            settings = SelectionSettings.for_protocol(self.protocol, rollouts)
            planner = make_planner(self.policy, hand, objects, settings, threads=self.threads)
            with progress_bar(name, len(some)) as show:
                start = process_time()
                plan = planner.plan(some, belief, progress=show)
            tried = 0.0 if plan.rollouts is None else float(plan.rollouts.mean())
            expected = None if plan.expected_success is None else float(plan.expected_success.mean())
            seconds[name] = {
                "seconds_per_grasp": (process_time() - start) / len(some),
                "rollouts_per_grasp": tried,
                "expected_success": expected,
            }
        if self.json is not None:
            about = {
                "hand": hand.name,
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
