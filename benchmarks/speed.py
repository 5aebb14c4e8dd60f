"""``python -m benchmarks.speed``: how long the package takes for what it does most.

Retargeting, planning, training, one robot's control step, and the start of the program; ``python -m
benchmarks.speed commands`` times whole commands. Pairs of runs on one machine, each from its own clone,
compare two versions.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from benchmarks.command import check_positive, main
from fungrasp.cli.console import progress_bar, table, write_json

if TYPE_CHECKING:
    from fungrasp.grasps import RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel

STARTS = {
    "import fungrasp [ms]": "import fungrasp",
    "fungrasp --help [ms]": "from fungrasp.cli.main import main; main(['--help'])",
}
"""Python code whose processes are timed, by what it is called."""

GRASPS, ROBOT = "{grasps}", "robot.npz"
COMMANDS = {
    "import": ("", "import fungrasp"),
    "--help": ("", "--help"),
    "hands list": ("", "hands list"),
    "retarget": ("retargeting:retarget", f"retarget {GRASPS} --out {ROBOT}"),
    "evaluate reference": ("evaluation:evaluate", f"evaluate {GRASPS} --policy reference"),
    "view, until it serves": (
        "viewer.choose_page:choose_page",
        "import fungrasp; fungrasp.view(wait=False).close()",
    ),
    "demo": ("media.demonstration:demonstrate", "demo"),
}
"""What a person waits for: the verb that does the work ("module:name", its time apart; "" for none), and the
words of the command line, or Python code."""

TIMED = """
import importlib, sys, time
spent = 0.0
place, words, code = sys.argv[1:4]
if place:
    module, name = place.split(":")
    module = importlib.import_module(f"fungrasp.{module}")
    verb = getattr(module, name)
    def timed(*arguments, **options):
        global spent
        start = time.perf_counter()
        try:
            return verb(*arguments, **options)
        finally:
            spent += time.perf_counter() - start
    setattr(module, name, timed)
if code:
    exec(code)
else:
    from fungrasp.cli.main import main
    try:
        status = main(words.split("\\n"))
    except SystemExit as end:
        status = end.code
    assert not status, status
open("spent", "w").write(str(spent))
"""
"""Runs a command, and says for how long its verb did."""


@dataclass(frozen=True)
class Speed:
    """Measure retargeting, planning, training, a control step and the start of the program."""

    what: Annotated[Literal["package", "commands"], tyro.conf.Positional] = "package"
    """The package's functions; or whole commands, cold (with an empty cache: nothing is compiled, no mesh is
    known) and warm, on the clock of the wall and of the processors, with the share of the verb."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    policy: str = "student"
    """Whose plans are made, and whose control step is timed."""
    planned: int = 8
    """Grasps to plan, evenly spread over the file."""
    worlds: int = 128
    """Worlds trained in together."""
    updates: int = 3
    """Updates of PPO."""
    repeat: int = 3
    """Times that retargeting, an import and the help are measured; the best one counts."""
    threads: int = 0
    """Number of threads; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        if self.what == "commands":
            self._run_commands()
        else:
            self._run_package()

    def _run_package(self) -> None:
        import numpy as np

        from fungrasp.cli.train import prepare_torch
        from fungrasp.core.provenance import machine
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.planning import plan
        from fungrasp.retargeting import retarget

        check_positive(planned=self.planned, worlds=self.worlds, updates=self.updates, repeat=self.repeat)
        prepare_torch()
        hand, human = load_hand(self.hand), load_human_grasps(self.grasps)
        objects = load_objects(human, self.objects)
        # The first one computes distance grids.
        robot = retarget(human, objects, hand, threads=self.threads)
        seconds = _best(lambda: retarget(human, objects, hand, threads=self.threads), self.repeat)
        found = {"retargeting [grasps/s]": len(human) / seconds}
        some = robot.select(np.unique(np.linspace(0, len(robot) - 1, self.planned).astype(int)))
        for rollouts in (True, False):
            name = f"planning, {'with rollouts' if rollouts else 'one motion'} [core s/grasp]"
            with progress_bar(name, 1.0) as show:
                start = process_time()
                plan(some, objects, self.policy, rollouts=rollouts, threads=self.threads, progress=show)
            found[name] = (process_time() - start) / len(some)
        found |= self._training(robot, objects, hand)
        found |= control_step(robot.select([0]), objects, hand, self.policy)
        for name, code in STARTS.items():
            found[name] = 1e3 * _best(lambda code=code: _process(code), self.repeat)
        about = {"hand": hand.name, "grasps": len(human), "threads": self.threads, "machine": machine()}
        if self.json is not None:
            write_json(self.json, about | {"speed": found})
        print(table([("what", "measured"), *((name, f"{value:,.3g}") for name, value in found.items())]))
        print("; ".join(f"{name} {value}" for name, value in about.items()))

    def _run_commands(self) -> None:
        """Each command cold, then ``repeat`` times warm, of which the fastest counts."""
        from fungrasp.core.provenance import machine

        check_positive(repeat=self.repeat)
        grasps = f"--grasps\n{Path(self.grasps).absolute() if Path(self.grasps).is_file() else self.grasps}"
        if self.objects is not None:
            grasps += f"\n--objects\n{self.objects.absolute()}"
        rows: dict[str, dict[str, float]] = {}
        with TemporaryDirectory() as folder:
            for name, (place, words) in COMMANDS.items():
                code = words if words.startswith("import ") else ""
                line = words.replace(" ", "\n").replace(GRASPS, grasps)
                runs = [_timed(Path(folder), place, line, code) for _ in range(1 + self.repeat)]
                rows[name] = {"cold": runs[0]["wall"], **min(runs[1:], key=lambda run: run["wall"])}
        head = ("command", "cold [s]", "warm [s]", "processors [s]", "the verb")
        lines = [
            (name, f"{r['cold']:.2f}", f"{r['wall']:.2f}", f"{r['cpu']:.2f}", f"{r['verb'] / r['wall']:.0%}")
            for name, r in rows.items()
        ]
        if self.json is not None:
            write_json(self.json, {"machine": machine(), "commands": rows})
        print(table([head, *lines]))
        print(machine())

    def _training(
        self, robot: RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
    ) -> dict[str, float]:
        """Control steps per second of PPO, and what of the time is in the worlds."""
        from fungrasp.training.environment import TrainingEnvironment
        from fungrasp.training.ppo import Trainer
        from fungrasp.training.settings import EnvironmentSettings, TrainSpec, Variety
        from fungrasp.training.training_sets import build_plan_library

        some = robot.select(range(min(len(robot), self.worlds)))
        library = build_plan_library(some, objects, hand, TrainSpec(threads=self.threads, variety=Variety(1)))
        settings = EnvironmentSettings(worlds=self.worlds)
        environment = TrainingEnvironment(library, objects, hand, settings, 0, self.threads)
        trainer, step, inside = Trainer(environment), environment.step, [0.0]
        # The first update does not count.
        trainer.learn_until(1)

        def timed(action: object) -> object:
            start = perf_counter()
            result = step(action)  # pyright: ignore[reportArgumentType]
            inside[0] += perf_counter() - start
            return result

        environment.step = timed  # pyright: ignore[reportAttributeAccessIssue]
        first, start = trainer.steps, perf_counter()
        trainer.learn_until(first + self.updates * trainer.alg.batch)
        whole = perf_counter() - start
        return {
            "training, learning included [control steps/s]": (trainer.steps - first) / whole,
            "training, share of its time in the worlds": inside[0] / whole,
        }


def control_step(
    grasp: RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand, policy: str
) -> dict[str, float]:
    """What the computer of one robot does in a control step of an episode, medians of the processor's time
    [ms]. Physics does not count, nor what only the test does.

    Args:
        grasp: a set of one.
        objects: by name.
        hand: the robot hand.
        policy: that acts.
    """
    import numpy as np

    from fungrasp.planning import MotionPlanner
    from fungrasp.policies import make_policy
    from fungrasp.simulation import build_scene
    from fungrasp.task import Action, LiftEnvironment, Policy

    scene = build_scene(hand, {name: objects[name] for name in grasp.object_name.tolist()})
    environment = LiftEnvironment(scene, 1, threads=1)
    plan = MotionPlanner(hand, objects).plan(grasp, environment.settle(grasp))
    acts, task = make_policy(policy, hand, objects), environment.task
    assert isinstance(acts, Policy)
    advance, acting, setpoints = task.advance_setpoints, list[float](), list[float]()

    def timed(action: Action) -> object:
        start = process_time()
        sequence = advance(action)
        setpoints.append(process_time() - start)
        return sequence

    task.advance_setpoints = timed  # pyright: ignore[reportAttributeAccessIssue]
    observation = environment.observe()
    acts.reset(plan, observation)
    while not task.done.all():
        start = process_time()
        action = acts.act(observation)
        acting.append(process_time() - start)
        environment.step(action)
        observation = environment.observe()
    return {
        "one control step, observation and policy [ms]": 1e3 * float(np.median(acting)),
        "one control step, setpoints [ms]": 1e3 * float(np.median(setpoints)),
    }


def _best(work: Callable[[], object], times: int) -> float:
    """Shortest of some times [s]."""
    seconds = []
    for _ in range(times):
        start = perf_counter()
        work()
        seconds.append(perf_counter() - start)
    return min(seconds)


def _timed(folder: Path, place: str, words: str, code: str) -> dict[str, float]:
    """Seconds of a process on the wall and on processors, and of its verb.

    Args:
        folder: in which it runs, with a cache of its own.
    """
    variables = {**os.environ, "FUNGRASP_CACHE": str(folder / "cache")}
    # As an installed package has them: without, each start compiles all that it imports.
    variables.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [sys.executable, "-c", TIMED, place, words, code]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    subprocess.run(command, check=True, cwd=folder, env=variables, stdout=subprocess.DEVNULL)
    wall, after = perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall": wall, "cpu": cpu, "verb": float((folder / "spent").read_text())}


def _process(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


COMMAND = Speed

if __name__ == "__main__":
    main("speed", COMMAND)
