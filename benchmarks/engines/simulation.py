"""``python -m benchmarks.engines speed``: physics steps per second."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar, table, write_json


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

        from benchmarks.engines.simulation_speed import simulation_speed
        from fungrasp.core.provenance import machine
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.retargeting import retarget

        check_positive(worlds=self.worlds, repeat=self.repeat)
        hand = load_hand(self.hand)
        human = load_human_grasps(self.grasps)
        human = human.select(np.arange(self.worlds) * max(1, len(human) // self.worlds) % len(human))
        objects = load_objects(human, self.objects)
        robot = retarget(human, objects, hand, threads=self.threads)
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
