"""``python -m benchmarks.gpu``: physics and control steps per second over the number of worlds, on each
device."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from benchmarks.command import check_positive
from fungrasp.cli.console import table, write_json
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path

if TYPE_CHECKING:
    from benchmarks.gpu.world_speed import WorldSpeed

MILLION = 1_000_000


@dataclass(frozen=True)
class ManyWorlds:
    """Measure worlds from one to thousands: physics, the task, training, rollouts, memory, and what did not
    fit."""

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
    seconds: float = math.inf
    """No measurement is begun after this time."""
    threads: int = 0
    """Threads of the processor; 0 means all."""
    buffers: tuple[int, int] | None = None
    """Room for contacts of a world (on average) and rows of constraints (at most); found by a probe by
    default."""
    rollouts_per_grasp: int = 33
    """Of the extrapolation: what a planner tries for a grasp at least."""
    json: Path | None = None
    """Write the numbers here (.json)."""
    plot: Path | None = None
    """Draw them here (.svg)."""

    def run(self) -> None:
        from time import perf_counter

        import numpy as np
        import torch

        from benchmarks.gpu.world_speed import world_speed
        from fungrasp.core.provenance import git_revision, machine
        from fungrasp.grasps import builtin_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.retargeting import retarget
        from fungrasp.simulation import BufferSizes
        from fungrasp.training.plan_library import Variety, build_plan_library

        check_positive(grasps=self.grasps, steps=self.steps, worlds=min(self.worlds))
        torch.set_num_threads(1)
        start, hand, human = perf_counter(), load_hand(self.hand), builtin_grasps()
        human = human.select(np.unique(np.linspace(0, len(human) - 1, self.grasps).astype(int)))
        objects = load_objects(human)
        robot = retarget(human, objects, hand, threads=self.threads)
        library = build_plan_library(robot, objects, hand, Variety(1), 0, self.threads)
        buffers = None if self.buffers is None else BufferSizes(*self.buffers)
        found: list[WorldSpeed] = []
        for device in self.devices:
            for worlds in self.worlds:
                if device != "cuda" and worlds > self.most_on_processor:
                    continue
                if perf_counter() - start > self.seconds:
                    print(f"{self.seconds:.0f} s are over: {device} with {worlds} worlds is left out")
                    continue
                try:
                    found.append(
                        world_speed(library, objects, hand, device, worlds, buffers, self.steps, self.threads)
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
        if self.plot is not None:
            with atomic_path(self.plot) as temporary:
                temporary.write_text(_drawn(found))
        rows = [
            ("device", "worlds", "physics/s", "task/s", "training/s", "physics", "task", "learning", "KiB")
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
        best = max(found, key=lambda one: one.rollouts)
        hours = MILLION * self.rollouts_per_grasp / best.rollouts / 3600
        print(
            f"{best.rollouts:,.0f} rollouts/s on {best.device} with {best.worlds} at once; extrapolated, a "
            f"million grasps with {self.rollouts_per_grasp} rollouts each take {hours:,.1f} h on one such "
            f"machine, {hours / 10:,.1f} h on ten"
        )
        print("; ".join(f"{name} {value}" for name, value in about.items()))


def _versions() -> dict[str, str]:
    """Of what computes on a GPU, and its name."""
    from importlib.metadata import PackageNotFoundError, version

    import torch

    found = {"gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else "none"}
    for name in ("torch", "mujoco-warp", "warp-lang"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def _drawn(found: list[WorldSpeed]) -> str:
    """Physics, control steps and rollouts per second over worlds, in powers of ten."""
    import numpy as np

    from fungrasp.core.plots import PlotLine, PlotPanel, panels_svg

    panels = []
    for name, title in (
        ("physics_steps", "physics steps/s"),
        ("training_steps", "control steps/s, learning included"),
        ("rollouts", "rollouts/s"),
    ):
        lines = []
        for device in dict.fromkeys(one.device for one in found):
            some = [one for one in found if one.device == device]
            across = np.log10([one.worlds for one in some])
            lines.append(PlotLine(across, np.log10([getattr(one, name) for one in some]), device))
        panels.append(PlotPanel(title, "worlds [powers of ten]", "[powers of ten]", lines))
    return panels_svg(panels, columns=3) + "\n"


COMMAND = ManyWorlds
