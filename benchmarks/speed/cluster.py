"""``python -m benchmarks.speed cluster``: what a cluster makes of its processors."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import progress_bar, table
from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

    from fungrasp.core.jobs import ClusterUse
    from fungrasp.evaluation import LiftTestResult
    from fungrasp.grasps import RobotGraspSet
    from fungrasp.objects import ObjectModel


@dataclass(frozen=True)
class BenchCluster:
    """Evaluate grasps in one process on one processor, and again on a Ray cluster of several machines with a
    processor each, all on this machine; compare the outcomes, grasp by grasp, and the work that a second of
    a processor does."""

    grasps: str = "builtin"
    """A file of human or of robot grasps, or "builtin"; they are repeated where there are fewer."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    policy: str = "reference"
    """As for `fungrasp evaluate`."""
    number: int = 2000
    """Grasps to evaluate."""
    machines: int = 2
    """Machines of the cluster."""
    lose: bool = False
    """Kill one of the machines when half of the work is done."""
    json: Path | None = None
    """Write the numbers here (.json), the two runs to a CSV file beside it."""

    def run(self) -> None:
        from time import perf_counter, process_time

        import numpy as np

        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation import evaluate, write_result
        from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.retargeting import retarget

        if self.number < 1 or self.machines < 1 + self.lose:
            raise FungraspError("--number must be at least 1, and --machines 1, or 2 with --lose")
        if find_spec("ray") is None:
            raise FungraspError("this needs Ray: pip install 'fungrasp[ray]'")
        hand, given = load_hand(self.hand), load_grasps(self.grasps)
        objects = load_objects(given, self.objects)
        if isinstance(given, RobotGraspSet):
            given.check_hand(hand)
            robot = given
        else:
            robot = retarget(given, objects, hand, threads=1)
        robot = robot.select(np.arange(self.number) % len(robot))
        start, used = perf_counter(), process_time()
        with progress_bar("one process", 1.0) as show:
            alone = evaluate(robot, objects, self.policy, threads=1, progress=show)
        one = {"run": "one process", "seconds": perf_counter() - start}
        one |= {"processor_seconds": process_time() - used, "processors": 1.0, "at_work": 1.0}
        found, use, used = self._on_cluster(robot, objects)
        same = _equal_episodes(alone, found)
        many = {
            "run": "cluster",
            "seconds": use.seconds,
            "processor_seconds": use.processor_seconds + used,
            "processors": use.processors,
            "at_work": use.share,
        }
        speed = one["processor_seconds"] / many["processor_seconds"]
        share = speed * use.share
        if self.json is not None:
            about = {
                "hand": hand.name,
                "policy": self.policy,
                "machines": self.machines,
                "lost": int(self.lose),
            }
            about |= {"grasps": len(robot), "equal": int(same.sum()), "jobs": use.jobs}
            about |= {"work_per_processor_second": speed, "share": share}
            write_result(self.json, run_record(0) | about, [one, many])
        head = ("", "seconds", "core seconds", "processors", "at work")
        rows = [
            (
                run["run"],
                f"{run['seconds']:.0f}",
                f"{run['processor_seconds']:.1f}",
                f"{run['processors']:.2f}",
                f"{run['at_work']:.1%}",
            )
            for run in (one, many)
        ]
        print(table([head, *rows]))
        lost = ", one machine lost" if self.lose else ""
        print(
            f"{same.sum()} of {len(robot)} outcomes are the same. A core second on the cluster does "
            f"{speed:.1%} of the work, and the cluster gives {share:.1%} of the sum of its processors{lost}"
        )
        print(machine())

    def _on_cluster(
        self, robot: RobotGraspSet, objects: Mapping[str, ObjectModel]
    ) -> tuple[LiftTestResult, ClusterUse, float]:
        """Result, use of the cluster, and processor time of this process meanwhile [s]."""
        from time import process_time

        import ray
        from ray.cluster_utils import Cluster

        from fungrasp.core.jobs import RayCluster
        from fungrasp.evaluation import evaluate

        machines = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
        nodes = [machines.add_node(num_cpus=1) for _ in range(self.machines)]
        cluster = RayCluster(str(machines.address))

        def watch(share: float) -> None:
            if self.lose and share >= 0.5 and nodes:
                machines.remove_node(nodes[-1], allow_graceful=False)
                nodes.clear()

        used = process_time()
        try:
            found = evaluate(robot, objects, self.policy, ray=cluster, progress=watch)
            used = process_time() - used
            assert cluster.use is not None
            return found, cluster.use, used
        finally:
            ray.shutdown()
            machines.shutdown()


def _equal_episodes(a: LiftTestResult, b: LiftTestResult) -> np.ndarray:
    """Which episodes have the same numbers, all of them, shape [E] bool."""
    import numpy as np

    same = np.ones(len(a.index), dtype=bool)
    others = b.outcomes.arrays() | {"index": b.index}
    for name, values in (a.outcomes.arrays() | {"index": a.index}).items():
        equal = values == others[name]
        if values.dtype.kind == "f":
            equal |= np.isnan(values) & np.isnan(others[name])
        same &= equal.reshape(len(same), -1).all(axis=1)
    return same
