"""Kills long work at random moments, lets it go on, and compares its result with the uninterrupted one.

    python tests/reliability/kill_series.py evaluate 100

A process that has imported everything forks one child for each attempt. A child is killed (SIGKILL) at a
random moment of the time that the whole work takes; the next goes on in the same folder. Once one has come to
its end, the result is compared and the next folder begun, until so many have been killed. Prints one line of
JSON; exits with 1 if a result differs, a child fails, or anything half-written is left.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

import numpy as np
import torch
from small_parts import parts_of
from small_training import BATCH, WORLDS, distilled, hand, run_spec, trained

from fungrasp.cli.main import main as fungrasp
from fungrasp.core.formats.onnx_file import message_fields
from fungrasp.core.jobs import PartStore
from fungrasp.evaluation import LiftTestSpec, evaluate, result_json, write_result
from fungrasp.evaluation.result_files import read_result, split_rows
from fungrasp.grasps import builtin_grasps, load_objects, save_robot_grasps
from fungrasp.planning import make_planner
from fungrasp.planning.selection.settings import RolloutSettings, SelectionSettings
from fungrasp.retargeting import retarget
from fungrasp.task import LiftProtocol
from fungrasp.training.distill import STUDENT
from fungrasp.training.learning_curve import CURVE, read_curve
from fungrasp.training.settings import CurveSettings, DistillSettings
from fungrasp.training.train import POLICY

UPDATES, ROUNDS = 42, 25
DISTILL = DistillSettings(steps=2, teacher_rounds=1, updates=2, minibatch=16, kept_rounds=12)
PLAN = SelectionSettings(
    candidates=4,
    rollouts=RolloutSettings(hold_time=0.3),
    confirmations=1,
    searches=1,
    more_searches=0,
    more=2,
)
OBJECTS = ("can", "tennis_ball", "mug", "banana")
TOO_LONG = 900.0
"""Time after which a child counts as hanging [s]."""

Work = Callable[[Path], None]
Result = Callable[[Path], Any]


# ---------------------------------------------------------------- what is killed


@cache
def robot_file(scratch: Path) -> Path:
    human = builtin_grasps()
    rows = [i for i, name in enumerate(human.object_name) if name in OBJECTS]
    human = human.select((rows * 3)[:12])
    path = scratch / "robot.npz"
    save_robot_grasps(path, retarget(human, load_objects(human), hand(), threads=1))
    return path


def run(*words: object) -> None:
    status = fungrasp([str(word) for word in words])
    if status:
        raise SystemExit(status)


def evaluation(scratch: Path) -> tuple[Work, Result]:
    grasps = robot_file(scratch)

    def work(folder: Path) -> None:
        files = "--json", folder / "whole.json", "--out", folder / "rows.json"
        run("evaluate", "--grasps", grasps, *files, "--threads", 1)

    def result(folder: Path) -> Any:
        whole = json.loads((folder / "whole.json").read_text())
        rows = read_result(folder / "rows.json").rows
        return [{k: v for k, v in whole.items() if k in ("success_rate", "trials")}, rows]

    return work, result


def planning(scratch: Path) -> tuple[Work, Result]:
    from fungrasp.grasps import load_robot_grasps

    grasps = load_robot_grasps(robot_file(scratch)).select([0, 1, 2, 3])
    objects = load_objects(grasps)

    def work(folder: Path) -> None:
        planner = make_planner("plan", hand(), objects, PLAN, threads=1)
        store = PartStore(folder / "planned.json.partial")
        spec = LiftTestSpec(policy="plan", lift=replace(LiftProtocol(), hold_time=0.5))
        with parts_of(1):
            tested = evaluate(grasps, objects, spec=spec, plans=planner, threads=1, store=store)
        write_result(folder / "planned.json", *split_rows(result_json(tested)))
        store.remove()

    return work, lambda folder: read_result(folder / "planned.json").rows


def training(scratch: Path) -> tuple[Work, Result]:

    def work(folder: Path) -> None:
        trained(folder / "run", run_spec(UPDATES * BATCH, CurveSettings(every=8 * BATCH)))

    return work, lambda folder: (
        weights(folder / "run" / POLICY),
        progress(folder / "run"),
        curve(folder / "run"),
    )


def distillation(scratch: Path) -> tuple[Work, Result]:
    teacher = scratch / "teacher"
    if not teacher.exists():
        in_child(lambda at: trained(at), teacher)

    def work(folder: Path) -> None:
        steps = ROUNDS * DISTILL.steps * WORLDS
        distilled(teacher, folder / "run", steps, DISTILL)

    return work, lambda folder: (weights(folder / "run" / STUDENT), progress(folder / "run"))


KINDS = {
    "evaluate": evaluation,
    "plan": planning,
    "train": training,
    "distill": distillation,
}


def weights(path: Path) -> bytes:
    """The graph of a policy file; its card holds times."""
    data = path.read_bytes()
    return b"".join(data[f.start : f.end] for f in message_fields(data, 0, len(data)) if f.number == 7)


def progress(folder: Path) -> list[Any]:
    lines = [json.loads(line) for line in (folder / "progress.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


def curve(folder: Path) -> list[Any]:
    """In words, as NaN is not itself."""
    return [str(point._replace(seconds=0.0)) for point in read_curve(folder / CURVE)]


# ---------------------------------------------------------------- who kills


def in_child(work: Work, folder: Path, kill_after: float | None = None) -> str:
    """Runs the work in a fork. "done", "killed", or what went wrong."""
    child = os.fork()
    if child == 0:
        status = 1
        with contextlib.suppress(BaseException), (folder.parent / "log").open("a") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
            try:
                torch.set_num_threads(1)
                work(folder)
                status = 0
            except BaseException:
                import traceback

                traceback.print_exc()
        os._exit(status)
    begun = time.monotonic()
    while True:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return "done" if status == 0 else f"status {status}"
        spent = time.monotonic() - begun
        if kill_after is not None and spent > kill_after:
            os.kill(child, signal.SIGKILL)
            return "done" if os.waitpid(child, 0)[1] == 0 else "killed"
        if spent > TOO_LONG:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return f"more than {TOO_LONG:g} s"
        time.sleep(0.002)


def left_over(folder: Path) -> list[str]:
    """Files of a finished folder that were not meant to stay."""
    names = [str(path.relative_to(folder)) for path in folder.rglob("*")]
    return [name for name in names if Path(name).name.startswith(".") or name.endswith(".partial")]


def series(what: str, times: int, scratch: Path) -> dict[str, Any]:
    """Kill one kind of work so many times."""
    work, result = KINDS[what](scratch)
    chance = random.Random(0)
    whole = scratch / "whole"
    whole.mkdir()
    begun = time.monotonic()
    outcome = in_child(work, whole)
    duration = time.monotonic() - begun
    if outcome != "done":
        raise SystemExit(f"{what}, uninterrupted: {outcome}\n{(scratch / 'log').read_text()}")
    wanted = result(whole)
    kills = finished = attempts = 0
    found: list[str] = []
    while kills < times:
        folder = Path(tempfile.mkdtemp(prefix=f"{what}-", dir=scratch))
        killed_here = 0
        while True:
            attempts += 1
            # Late enough to make some progress in the end, whatever the machine is busy with.
            wait = None if kills >= times or killed_here > 12 else chance.uniform(0.0, duration)
            outcome = in_child(work, folder, wait)
            if outcome == "killed":
                kills += 1
                killed_here += 1
                continue
            if outcome != "done":
                found.append(f"{folder.name}: {outcome}")
            break
        finished += 1
        if outcome == "done":
            if result(folder) != wanted:
                found.append(f"{folder.name}: another result")
            found += [f"{folder.name}: {name} is left" for name in left_over(folder)]
        print(f"{what}: {kills} killed, {finished} finished, {len(found)} found", file=sys.stderr, flush=True)
    return {
        "what": what,
        "kills": kills,
        "finished": finished,
        "attempts": attempts,
        "seconds_uninterrupted": round(duration, 2),
        "found": found,
    }


def main(arguments: list[str]) -> int:
    """The command line: what is killed, one of ``KINDS``, and how often."""
    what, times = arguments
    np.seterr(all="ignore")
    with tempfile.TemporaryDirectory(prefix="kill-series-") as scratch:
        os.environ.setdefault("FUNGRASP_CACHE", f"{scratch}/cache")
        line = series(what, int(times), Path(scratch))
    print(json.dumps(line))
    return 1 if line["found"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
