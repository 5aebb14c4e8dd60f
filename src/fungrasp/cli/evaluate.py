"""``fungrasp evaluate``: how many grasps lift the object, in simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import progress_bar, table, write_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fungrasp.evaluation import DynamicResult
    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel


@dataclass(frozen=True)
class Evaluate:
    """Try grasps in simulation: reach, grasp, lift, hold; measure how many succeed."""

    grasps: str = "builtin"
    """A file of human grasps (they are retargeted first) or of robot grasps of --hand, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    policy: str = "reference"
    """What moves the hand: "reference"."""
    refine: int = 0
    """Try this many variations of each grasp in simulation first and keep the best."""
    method: tuple[str, ...] = ("ours",)
    """How human grasps are retargeted: ours, angle-copy, dexgraspnet; several are compared side by side."""
    seed: tuple[int, ...] = (0,)
    """Of everything that is random; with several, each grasp is tried with each."""
    json: Path | None = None
    """Write every number here (.json). An interrupted run goes on where it was when it is given again."""
    record: Path | None = None
    """Folder to which each trial is recorded (.npz)."""
    mass_scale: float = 1.0
    """The object weighs this many times what the policy believes."""
    friction: float | None = None
    """Sliding friction of hand, object and table; 0.9 by default."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """The object is this far [m] and turned by this angle [degrees] from where the policy believes it is."""
    table_height: float = 0.0
    """The table is this much higher than the policy believes [m]."""
    threads: int = 0
    """0 means all processors; the result does not depend on it."""

    def run(self) -> None:
        from math import radians
        from time import perf_counter

        from fungrasp.errors import FungraspError
        from fungrasp.evaluation import Disturbance, evaluate, result_json
        from fungrasp.evaluation.dynamic import check_hand
        from fungrasp.evaluation.results import machine
        from fungrasp.grasps import RobotGraspSet, load_grasps
        from fungrasp.hands import load_hand
        from fungrasp.retarget import load_objects

        disturbance = Disturbance(
            self.mass_scale, self.friction, self.pose_noise[0], radians(self.pose_noise[1]), self.table_height
        )
        hand = load_hand(self.hand)
        grasps = load_grasps(self.grasps)
        if isinstance(grasps, RobotGraspSet):
            check_hand(grasps, hand)
        objects = load_objects(grasps, self.objects)
        start = perf_counter()
        results: dict[str, DynamicResult] = {}
        for method, robot in self._robot_grasps(grasps, objects, hand).items():
            with progress_bar(f"{hand.name}, {method}", len(robot) * len(self.seed)) as show:
                results[method] = evaluate(
                    robot,
                    objects,
                    hand,
                    self.policy,
                    seeds=self.seed,
                    threads=self.threads,
                    disturbance=disturbance,
                    record=self.record,
                    progress=show,
                )
        seconds = perf_counter() - start
        if self.json is not None:
            about = {"seconds": seconds, "machine": machine()}
            jsons = {method: result_json(result) for method, result in results.items()}
            whole: dict[str, Any] = next(iter(jsons.values())) if len(jsons) == 1 else {"methods": jsons}
            write_json(self.json, whole | about)
        for method, result in results.items():
            if len(results) > 1:
                print(f"{method}:")
            print(result_table(result))
        print(f"{sum(len(r.index) for r in results.values())} trials in {seconds:.1f} s")

    def _robot_grasps(
        self, grasps: HumanGraspSet | RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
    ) -> dict[str, RobotGraspSet]:
        from fungrasp.cli.retarget import retargeted
        from fungrasp.grasps import RobotGraspSet

        if isinstance(grasps, RobotGraspSet):
            return {"robot grasps": grasps}
        return {method: retargeted(grasps, objects, hand, method, self.threads)[0] for method in self.method}


COMMAND = Evaluate


def result_table(result: DynamicResult) -> str:
    """Objects and their rates of success."""
    from fungrasp.evaluation.results import result_json

    numbers = result_json(result)
    rows = [("object", "trials", "success", "95 % interval", "contacts", "slip [mm/s]", "pushed [mm]")]
    rows += [_row(name, part) for name, part in numbers["by_object"].items()]
    rows.append(_row("all", numbers))
    means = numbers["mean_over_objects"]
    rows.append(
        (
            "mean over objects",
            "",
            f"{means['success_rate']:.1%}",
            "",
            f"{means['contact_ratio']:.2f}",
            f"{means['sim_distance_hand_mm_s']:.1f}",
            f"{1e3 * means['pushed_m']:.0f}",
        )
    )
    return table(rows)


def _row(name: str, part: Mapping[str, Any]) -> tuple[str, ...]:
    low, high = part["success_interval"]
    return (
        name,
        str(part["count"]),
        f"{part['success_rate']:.1%}",
        f"{low:.1%} – {high:.1%}",
        f"{part['contact_ratio']:.2f}",
        f"{part['sim_distance_hand_mm_s']:.1f}",
        f"{1e3 * part['pushed_m']:.0f}",
    )
