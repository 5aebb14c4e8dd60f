"""``python -m benchmarks.gpu``: physics and control steps per second over the number of worlds, on each
device, and the memory that a world takes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
import torch

from benchmarks.command import check_positive, main
from fungrasp.cli.console import table, write_json
from fungrasp.core.errors import FungraspError
from fungrasp.core.provenance import git_revision, machine
from fungrasp.geometry.poses import Array
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import retarget
from fungrasp.simulation import Device, Engine, SceneSettings
from fungrasp.simulation.mujoco_warp import MujocoWarpWorlds
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.ppo import Trainer
from fungrasp.training.settings import EnvironmentSettings, PpoSettings, TrainSpec, Variety
from fungrasp.training.training_sets import PlanLibrary, build_plan_library


@dataclass(frozen=True)
class WorldSpeed:
    """Speed of W worlds together, in steps of all of them per second of wall time."""

    device: str
    """Where."""
    worlds: int
    """W."""
    physics_steps: float
    """Physics steps per second of the engine alone."""
    environment_steps: float
    """Control steps per second of training without learning: actions, setpoints, observation, reward, new
    episodes."""
    training_steps: float
    """Control steps per second of training, learning included."""
    physics_share: float
    """Share of training's time that is physics."""
    task_share: float
    """Share of all else but learning."""
    learning_share: float
    """Share of collecting actions and learning."""
    bytes_per_world: int | None
    """Memory that a world takes; None on the processor."""
    problems: tuple[str, ...]
    """What did not fit, in words."""


@dataclass(frozen=True)
class ManyWorlds:
    """Measure worlds from one to thousands: physics, the task, training, memory, and what did not fit."""

    devices: tuple[Literal["cuda", "cpu-warp", "cpu"], ...] = ("cuda", "cpu")
    """Where."""
    worlds: tuple[int, ...] = (1, 16, 128, 1024, 2048, 4096, 8192, 16384)
    """How many at once."""
    most_on_processor: int = 1024
    """More than these are left out on the processor."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    grasps: int = 20
    """Built-in grasps that the worlds share."""
    steps: int = 24
    """Control steps of a measurement, and between two updates."""
    threads: int = 0
    """Threads of the processor; 0 means all."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        check_positive(grasps=self.grasps, steps=self.steps, worlds=min(self.worlds))
        torch.set_num_threads(1)
        hand, human = load_hand(self.hand), builtin_grasps()
        human = human.select(np.unique(np.linspace(0, len(human) - 1, self.grasps).astype(int)))
        objects = load_objects(human)
        robot = retarget(human, objects, hand, threads=self.threads)
        library = build_plan_library(
            robot, objects, hand, TrainSpec(threads=self.threads, variety=Variety(1))
        )
        found: list[WorldSpeed] = []
        for device in self.devices:
            for worlds in self.worlds:
                if device != "cuda" and worlds > self.most_on_processor:
                    continue
                try:
                    found.append(
                        world_speed(library, objects, hand, device, worlds, self.steps, self.threads)
                    )
                except FungraspError as error:
                    print(f"{device} with {worlds} worlds is left out: {error}")
                    break
                rate = f"{found[-1].training_steps:,.0f} control steps/s, learning included"
                print(f"{device}, {worlds} worlds: {rate}", flush=True)
        if not found:
            raise FungraspError("nothing could be measured")
        about = {"hand": hand.name, "machine": machine(), "revision": git_revision()} | _versions()
        if self.json is not None:
            write_json(self.json, about | {"each": [asdict(one) for one in found]})
        rows = [
            (
                "device",
                "worlds",
                "physics/s",
                "task/s",
                "training/s",
                "physics",
                "task",
                "learning",
                "KiB",
            )
        ]
        rows += [
            (
                one.device,
                f"{one.worlds:,}",
                f"{one.physics_steps:,.0f}",
                f"{one.environment_steps:,.0f}",
                f"{one.training_steps:,.0f}",
                f"{one.physics_share:.0%}",
                f"{one.task_share:.0%}",
                f"{one.learning_share:.0%}",
                "" if one.bytes_per_world is None else f"{one.bytes_per_world / 1024:.0f}",
            )
            for one in found
        ]
        print(table(rows))
        for one in found:
            for problem in one.problems:
                print(f"{one.device}, {one.worlds} worlds: {problem}")
        print("; ".join(f"{name} {value}" for name, value in about.items()))


def _versions() -> dict[str, str]:
    """Of what computes on a GPU, and its name."""
    found = {"gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else "none"}
    for name in ("torch", "mujoco-warp", "warp-lang"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def world_speed(
    library: PlanLibrary,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    device: Device,
    worlds: int,
    steps: int = 24,
    threads: int = 0,
) -> WorldSpeed:
    """Measure one number of worlds on one device, each part after a first round that does not count.

    Args:
        library: plans of ``hand``; they are spread over the worlds.
        objects: by name.
        hand: the robot hand.
        device: where.
        worlds: W.
        steps: control steps between two updates, and of the other measurements.
        threads: of the processor; 0 means all.
    """
    settings = EnvironmentSettings(worlds=worlds)
    environment = TrainingEnvironment(
        library, objects, hand, settings, 0, threads, SceneSettings(device=device)
    )
    engine = environment.episodes.engine
    bare = _physics(engine, environment.episodes.task.controls, steps)
    still = 0.0 * environment.tracker.action
    environment.step(still)
    alone = _rate(lambda: environment.step(still), steps, worlds, engine)
    with (
        timed(engine, "step", _wait(engine)) as inside,
        timed(environment, "step", _wait(engine)) as stepping,
    ):
        trainer = Trainer(environment, PpoSettings(steps=steps, warm_up=0))
        trainer.learn_until(1)
        inside[0] = stepping[0] = 0.0
        start = perf_counter()
        trainer.learn_until(trainer.steps + steps * worlds)
        whole = perf_counter() - start
    return WorldSpeed(
        device=device,
        worlds=worlds,
        physics_steps=bare,
        environment_steps=alone,
        training_steps=steps * worlds / whole,
        physics_share=inside[0] / whole,
        task_share=(stepping[0] - inside[0]) / whole,
        learning_share=1.0 - stepping[0] / whole,
        bytes_per_world=_memory(engine),
        problems=tuple(engine.problems()),
    )


@contextmanager
def timed(obj: Any, name: str, wait: Callable[[], None] = lambda: None) -> Iterator[list[float]]:
    """A list of one number, the seconds spent in a method inside the block. wait: for a device to finish."""
    seconds, method = [0.0], getattr(obj, name)

    def run(*arguments: Any, **named: Any) -> Any:
        start = perf_counter()
        result = method(*arguments, **named)
        wait()
        seconds[0] += perf_counter() - start
        return result

    setattr(obj, name, run)
    try:
        yield seconds
    finally:
        setattr(obj, name, method)


def _wait(engine: Engine) -> Callable[[], None]:
    """Waits for the device to finish."""
    return engine.wait if isinstance(engine, MujocoWarpWorlds) else lambda: None


def _rate(work: Callable[[], object], times: int, worlds: int, engine: Engine) -> float:
    _wait(engine)()
    start = perf_counter()
    for _ in range(times):
        work()
    _wait(engine)()
    return times * worlds / (perf_counter() - start)


def _physics(engine: Engine, controls: Array, times: int) -> float:
    """Physics steps per second, ten to a call."""
    state = engine.get_state()
    engine.step(controls, 10)
    found = 10 * _rate(lambda: engine.step(controls, 10), times, len(engine), engine)
    engine.restore(state)
    return found


def _memory(engine: Engine) -> int | None:
    return engine.bytes_per_world if isinstance(engine, MujocoWarpWorlds) else None


COMMAND = ManyWorlds

if __name__ == "__main__":
    main("gpu", COMMAND)
