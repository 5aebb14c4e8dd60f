"""``fungrasp bench``: speed of retargeting, planning, clusters, simulation, training, perception, drivers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.bench_cluster import BenchCluster
from fungrasp.cli.bench_depth import BenchDepth
from fungrasp.cli.bench_identify import BenchIdentify
from fungrasp.cli.bench_perception import BenchPerception
from fungrasp.cli.bench_planning import BenchPlanning
from fungrasp.cli.bench_robot import BenchFaults, BenchRobot
from fungrasp.cli.bench_wire import BenchWire
from fungrasp.cli.console import progress_bar, table, write_json

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
    peers: bool = False
    """Compare with the other packages that are installed (dex-retargeting, dexi-rs, mink: extra "bench"), by
    processor time on one thread, and write --json with one row per grasp."""
    lift: bool = False
    """With --peers: lift the objects too, by the reference controller, with and without adaptation of the
    grasps to the settled object."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        if self.peers:
            from fungrasp.cli.bench_peers import compare_with_peers

            compare_with_peers(self)
            return
        from fungrasp.errors import UnknownNameError
        from fungrasp.evaluation.results import finite
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.provenance import machine
        from fungrasp.retargeting import METHODS

        _check_positive(repeat=self.repeat)
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
        from fungrasp.cli.retarget import retargeted
        from fungrasp.evaluation import static_quality

        rounds = [retargeted(human, objects, hand, method, self.threads) for _ in range(self.repeat)]
        quality = static_quality(rounds[0][0], human, objects, hand)
        return {"grasps_per_second": max(rate for _, rate in rounds), "quality": quality.summary()}


@dataclass(frozen=True)
class Simulation:
    """Measure physics steps per second: the environment, bare physics, and a Python loop over mj_step."""

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"; they are spread over the worlds."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    worlds: int = 128
    """Worlds stepped together."""
    repeat: int = 3
    """Rounds, of which the fastest counts."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        from dataclasses import asdict

        import numpy as np

        from fungrasp.cli.retarget import retargeted
        from fungrasp.evaluation.speed import simulation_speed
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.provenance import machine

        _check_positive(worlds=self.worlds, repeat=self.repeat)
        hand = load_hand(self.hand)
        human = load_human_grasps(self.grasps)
        human = human.select(np.arange(self.worlds) * max(1, len(human) // self.worlds) % len(human))
        objects = load_objects(human, self.objects)
        robot, _ = retargeted(human, objects, hand, "ours", self.threads)
        with progress_bar("simulating", 1.0) as show:
            speed = simulation_speed(robot, objects, hand, self.threads, self.repeat, show)
        if self.json is not None:
            about = {"hand": hand.name, "threads": self.threads, "machine": machine()}
            write_json(self.json, about | asdict(speed) | {"environment_over_bare": speed.share})
        rows = [
            ("stepping", "steps/s", "ratio"),
            ("environment", f"{speed.environment:,.0f}", "1.00"),
            ("bare mujoco.batch", f"{speed.bare:,.0f}", f"{speed.bare / speed.environment:.2f}"),
            ("Python loop over mj_step", f"{speed.loop:,.0f}", f"{speed.loop / speed.environment:.2f}"),
        ]
        print(table(rows))
        print(
            f"the environment steps at {speed.share:.0%} of bare physics, "
            f"{speed.environment / speed.loop:.1f} times as fast as the loop; "
            f"{'the' if speed.identical else 'NOT the'} same motion in all three"
        )
        print(f"{speed.worlds} worlds of {hand.name}; {machine()}")


@dataclass(frozen=True)
class Training:
    """Measure training steps per second, against bare physics, and how long one robot's control step
    takes."""

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"; they are spread over the worlds."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    policy: str | None = None
    """Policy of the one robot (.onnx, or one of `fungrasp policies list`); an untrained student by default,
    which takes the same time."""
    worlds: int = 256
    """Worlds trained in together."""
    steps: int = 40
    """Control steps of the measurement against bare physics."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        from fungrasp.cli.train import check_packages

        check_packages()
        from dataclasses import asdict

        import numpy as np

        from fungrasp.cli.retarget import retargeted
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.policies.checkpoint.checkpoint_file import load_policy
        from fungrasp.provenance import machine
        from fungrasp.training.environment import EnvironmentSettings, TrainingEnvironment
        from fungrasp.training.plan_library import Variety, build_plan_library
        from fungrasp.training.settings import PpoSettings
        from fungrasp.training.speed import (
            acting_speed,
            environment_speed,
            untrained_student,
            update_speed,
        )

        _check_positive(worlds=self.worlds, steps=self.steps)
        hand = load_hand(self.hand)
        network = None if self.policy is None else load_policy(self.policy)
        human = load_human_grasps(self.grasps)
        human = human.select(np.unique(np.linspace(0, len(human) - 1, self.worlds).astype(int)))
        objects = load_objects(human, self.objects)
        robot, _ = retargeted(human, objects, hand, "ours", self.threads)
        settings = EnvironmentSettings(worlds=self.worlds)
        with progress_bar("planning", len(robot)) as show:
            library = build_plan_library(robot, objects, hand, Variety(1), 0, self.threads, show)
        with progress_bar("stepping", self.steps) as show:
            stepping = environment_speed(library, objects, hand, settings, self.steps, 0, self.threads, show)
        environment = TrainingEnvironment(library, objects, hand, settings, 0, self.threads)
        updating = update_speed(environment, PpoSettings())
        network = network or untrained_student(library, objects, hand)
        acting = acting_speed(network, robot.select([0]), objects, hand)
        if self.json is not None:
            about = {"hand": hand.name, "threads": self.threads, "machine": machine()}
            shares = {"environment_over_bare": stepping.share, "acting_ms": acting.total}
            parts = {"stepping": asdict(stepping), "ppo": asdict(updating), "acting": asdict(acting)}
            write_json(self.json, about | parts | shares)
        rows = [
            ("stepping", "control steps/s", "physics steps/s"),
            *(
                (name, f"{speed:,.0f}", f"{speed * stepping.physics_steps:,.0f}")
                for name, speed in (
                    ("bare mujoco.batch", stepping.bare),
                    ("environment", stepping.environment),
                    ("PPO, learning included", updating.steps),
                )
            ),
        ]
        print(table(rows))
        print(
            f"the environment steps at {stepping.share:.0%} of bare physics"
            f"{'' if stepping.identical else ', but NOT the same motion'}; PPO spends "
            f"{updating.environment:.0%} of the time in it, {updating.learning:.0%} on updates"
        )
        print(
            f"one robot: {acting.total:.2f} ms for a control step, {acting.policy:.2f} for observation and "
            f"policy, {acting.control:.2f} for setpoints"
        )
        print(f"{stepping.worlds} worlds of {hand.name}; {machine()}")


COMMAND = {
    "retarget": Retargeting,
    "simulation": Simulation,
    "training": Training,
    "planning": BenchPlanning,
    "cluster": BenchCluster,
    "perception": BenchPerception,
    "depth": BenchDepth,
    "robot": BenchRobot,
    "faults": BenchFaults,
    "wire": BenchWire,
    "identify": BenchIdentify,
}


def _check_positive(**values: int) -> None:
    from fungrasp.errors import FungraspError

    for name, value in values.items():
        if value < 1:
            raise FungraspError(f"--{name} must be at least 1, not {value}")
