"""``python -m benchmarks.speed training``: training steps per second, and one robot's control step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar, table, write_json


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
        from fungrasp.cli.training_options import check_packages

        check_packages()
        from dataclasses import asdict

        import numpy as np
        import torch

        from benchmarks.speed.training_speed import (
            acting_speed,
            environment_speed,
            untrained_student,
            update_speed,
        )
        from fungrasp.core.provenance import machine
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.policies.checkpoint.checkpoint_file import load_policy
        from fungrasp.retargeting import retarget
        from fungrasp.training.environment import EnvironmentSettings, TrainingEnvironment
        from fungrasp.training.plan_library import Variety, build_plan_library
        from fungrasp.training.settings import PpoSettings

        check_positive(worlds=self.worlds, steps=self.steps)
        # As `fungrasp train` does: more threads make small networks slower, most of all beside other work.
        torch.set_num_threads(1)
        hand = load_hand(self.hand)
        network = None if self.policy is None else load_policy(self.policy)
        human = load_human_grasps(self.grasps)
        human = human.select(np.unique(np.linspace(0, len(human) - 1, self.worlds).astype(int)))
        objects = load_objects(human, self.objects)
        robot = retarget(human, objects, hand, threads=self.threads)
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
