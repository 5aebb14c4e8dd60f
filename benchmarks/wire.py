"""``python -m benchmarks.wire``: the whole chain over the wire, again and again: deployments on emulated
devices in another process, on the clock of the wall."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import check_positive, main
from benchmarks.fault_series.wire_trial import ControlProcess
from benchmarks.twins.twin_episode import deploy_where_reached
from fungrasp.cli.console import table
from fungrasp.core.errors import FungraspError
from fungrasp.core.provenance import run_record
from fungrasp.deployment.deploy import DeploymentTask, deploy_on_robot, deployment_task
from fungrasp.deployment.deployment_result import DeadlineMonitor, DeploymentResult
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import UnreachableError, reachable_placements
from fungrasp.deployment.spec import DeploymentSpec, GraspChoice, Phase
from fungrasp.evaluation.result_files import Row, read_result, write_result
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.robots.twin.world import HoldSample, TwinWorld, held_as_shown, held_throughout, hold_sample
from fungrasp_emulators.cell import CellEmulation

EDGES_MS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Edges of the histogram of lateness [ms]."""
SAMPLE_PERIOD = 0.02
"""Time between two looks at the truth [s]."""
LONGEST = 60.0
"""An emulation that takes longer to begin or to end has failed [s]."""


@dataclass(frozen=True, eq=False)
class EmulationTask:
    """What is emulated."""

    cell: RobotCell
    """Whose addresses are on the loopback."""
    obj: ObjectModel
    """The object as it is believed."""
    placement: np.ndarray
    """Where it is put, world frame, shape [7]."""
    twin: int
    """Which twin."""


@dataclass(frozen=True)
class EmulationRecord:
    """What was true, from the emulators' readiness to their end."""

    samples: list[HoldSample]
    """Every 20 ms."""
    seconds: float
    """Meanwhile [s]."""
    late: float
    """How far the twin fell behind the clock at worst [s]."""
    lost: float
    """Time that it lost in all [s]."""


class EmulationProcess(ControlProcess):
    """Emulates a cell in a process of its own; a context manager."""

    def __init__(self, task: EmulationTask):
        super().__init__(run_emulation, task)
        self._await("ready")

    def end(self) -> EmulationRecord:
        """End the emulation; what was true."""
        self.tell("end")
        return self._await("truth")

    def _await(self, what: str) -> Any:
        deadline = time.monotonic() + LONGEST
        while what not in self.heard:
            self.listen(0.05)
            if "error" in self.heard or not self.alive or time.monotonic() > deadline:
                self.listen(0.0)
                said = self.heard.get("error", ("the process of the emulators has ended by itself",))
                if what not in self.heard:
                    self.__exit__()
                    raise FungraspError(said[0])
        return self.heard[what][0]


def run_emulation(task: EmulationTask, pipe: Connection) -> None:
    """Emulate until a word comes; the process's main function.

    Messages through the pipe: ``("ready", True)``, ``("truth", EmulationRecord)``, ``("error", text)``.
    """
    hand = load_hand(task.cell.hand)
    world = TwinWorld(task.cell, hand, task.obj, cell_twin(task.cell, hand, task.twin))
    world.settle(task.placement)
    settled, samples = float(world.center_of_mass()[2]), []
    try:
        with CellEmulation(task.cell, world, task.obj.name) as emulation:
            pipe.send(("ready", True))
            began = time.monotonic()
            while not pipe.poll(SAMPLE_PERIOD):
                samples.append(hold_sample(world, settled))
            twin = emulation.twin
            record = EmulationRecord(samples, time.monotonic() - began, twin.latest, twin.lost)
        pipe.send(("truth", record))
    except FungraspError as error:
        pipe.send(("error", str(error)))


@dataclass(frozen=True)
class WireRun:
    """One deployment."""

    object: str
    """Name of the object."""
    twin: int
    """Which twin."""
    success: bool
    """Whether the object was lifted and held, in truth."""
    height_m: float
    """Least height of its center of mass during the hold [m]; -1 where there was none."""
    phase: str
    """Where it ended."""
    fault: str
    """Why the robot stopped, "" if it did not."""
    ticks_10hz: dict[str, int]
    """Control steps by lateness."""
    ticks_50hz: dict[str, int]
    """Setpoints by lateness."""
    latest_10hz_ms: float
    """Largest lateness of a control step [ms]; -1 where there was none."""
    latest_50hz_ms: float
    """Largest lateness of a setpoint [ms]; -1 where there was none."""
    longest_silence_ms: dict[str, float]
    """Longest time that the time stamp of arm and hand stood still [ms]."""
    twin_latest_ms: float
    """How far the twin fell behind the clock at worst [ms]."""
    twin_lost_ms: float
    """Time that the twin lost in all [ms]."""
    placements: int = 0
    """Placements of the object; of all but the last the robot said that it can't reach the grasp."""
    seconds: float = 0.0
    """The whole run took, from placing the object on [s]."""
    images: int = 0
    """Images that were looked at; 0 where the grasp is not from one."""
    grasp_seconds: float = 0.0
    """From the image, or the file of grasps, to the robot grasp [s]."""
    attempts: int = 0
    """Of the robot at the object; success is of the last."""
    held_as_shown: bool = False
    """Whether it was held where and how the person held it, in truth."""


def run_over_the_wire(task: DeploymentTask, twin: int) -> WireRun:
    """Start emulators with a twin in another process and deploy on them.

    Args:
        task: its cell's addresses are on the loopback.

    Returns:
        how it went. Where the robot says that it can't reach the grasp, the object is put elsewhere, as a
        person would do; after ``MOST_PLACEMENTS`` the run ends idle, with what is in the way as its fault.

    Raises:
        FungraspError: the emulators can't be started, or a device does not answer.
    """
    began = time.monotonic()
    placements = reachable_placements(task.cell, task.hand, task.obj, task.grasp, task.spec.seed)
    run, count, said = deploy_where_reached(placements, lambda placement: _run_at(task, twin, placement))
    seconds = time.monotonic() - began
    if run is None:
        return _not_begun(task, twin, said, count, seconds)
    return replace(run, placements=count, seconds=seconds)


def _run_at(task: DeploymentTask, twin: int, placement: np.ndarray) -> WireRun:
    """A run with the object at a placement, shape [7]."""
    with EmulationProcess(EmulationTask(task.cell, task.obj, placement, twin)) as process:
        try:
            result = deploy_on_robot(task, [_Alone()])
        except UnreachableError:
            process.end()
            raise
        except FungraspError as error:
            process.end()
            raise FungraspError(f"twin {twin}: {error}") from error
        record = process.end()
    held = _held(result, record)
    success = bool(held) and held_throughout(held, held[-1].time - held[0].time)
    shown = held_as_shown(held, task.hand, task.obj, task.grasp)
    return WireRun(
        object=task.obj.name,
        twin=twin,
        success=success,
        held_as_shown=success and shown is not None and bool(shown.holds[0]),
        height_m=min((s.height for s in held), default=-1.0),
        phase=str(result.phase),
        fault=result.fault,
        ticks_10hz=_histogram(result.ticks),
        ticks_50hz=_histogram(result.setpoints),
        latest_10hz_ms=_latest(result.ticks),
        latest_50hz_ms=_latest(result.setpoints),
        longest_silence_ms={name: 1e3 * s for name, s in result.longest_silence.items()},
        twin_latest_ms=1e3 * record.late,
        twin_lost_ms=1e3 * record.lost,
        attempts=result.attempts,
    )


def _not_begun(task: DeploymentTask, twin: int, fault: str, placements: int, seconds: float) -> WireRun:
    """A run in which nothing moved."""
    none = DeadlineMonitor(0.0)
    return WireRun(
        object=task.obj.name,
        twin=twin,
        success=False,
        height_m=-1.0,
        phase=str(Phase.IDLE),
        fault=fault,
        ticks_10hz=_histogram(none),
        ticks_50hz=_histogram(none),
        latest_10hz_ms=_latest(none),
        latest_50hz_ms=_latest(none),
        longest_silence_ms={},
        twin_latest_ms=0.0,
        twin_lost_ms=0.0,
        placements=placements,
        seconds=seconds,
    )


def _held(result: DeploymentResult, record: EmulationRecord) -> list:
    """Samples of the hold: both processes have the clock of one machine."""
    begin = result.times.get(Phase.HOLD)
    end = result.times.get(Phase.PUT_DOWN)
    if begin is None or end is None:
        return []
    return [s for s in record.samples if begin <= s.time <= end]


def _histogram(monitor: DeadlineMonitor) -> dict[str, int]:
    """Number of ticks by lateness: "<= 0.1 ms", ..., "> 50 ms"."""
    place = np.searchsorted(EDGES_MS, 1e3 * np.array(monitor.lateness))
    names = [f"<= {edge:g} ms" for edge in EDGES_MS] + [f"> {EDGES_MS[-1]:g} ms"]
    return {name: int(np.sum(place == i)) for i, name in enumerate(names)}


def _latest(monitor: DeadlineMonitor) -> float:
    return 1e3 * max(monitor.lateness, default=-1e-3)


class _Alone(DeploymentObserver):
    """Nobody is there who would say that the hand may let go."""

    def hold(self, robot: Robot) -> bool:
        return True


@dataclass(frozen=True)
class BenchWire:
    """Deploy a grasp on emulated devices in another process, each time on another twin, on the clock of the
    wall; count lifts and late ticks."""

    robot: str = "ur5e-allegro-emulated"
    """A cell whose addresses are on the loopback."""
    choice: GraspChoice = field(default_factory=lambda: GraspChoice(grasp="wine_glass"))
    """The grasp."""
    policy: str = "plan"
    """What moves the hand: "plan", "reference", "student", or a policy file."""
    attempts: int = 1
    """Most attempts of a policy that watches (a student)."""
    runs: int = 20
    """Deployments; the first is on twin 0, the next on twin 1, and so on."""
    json: Path | None = None
    """Write every run here (.json, with a .csv beside), anew after each; a stopped series goes on."""

    def run(self) -> None:
        check_positive(runs=self.runs)
        hand, image = load_hand(load_cell(self.robot).hand), self.choice.image
        header = {
            "robot": self.robot,
            "policy": self.policy,
            "image": image or "none",
            "attempts": self.attempts,
        }
        began = time.monotonic()
        grasp, objects = self.choice.robot(hand, 0)
        seen = {"images": int(image is not None), "grasp_seconds": time.monotonic() - began}
        runs = self._known(header)
        for twin in range(len(runs), self.runs):
            spec = DeploymentSpec(
                self.robot, self.policy, self.attempts, seed=twin, threads=self.choice.threads
            )
            run = replace(run_over_the_wire(deployment_task(grasp, objects, spec), twin), **seen)
            if run.fault.startswith("interrupted"):
                # What it was stopped in is not kept; the same command goes on there.
                raise KeyboardInterrupt
            runs.append(run)
            if self.json is not None:
                write_result(self.json, {**header, **run_record(0)}, [asdict(run) for run in runs])
            print(_line(run), flush=True)
        rows: list[tuple[str, ...]] = [("lateness", "10 Hz", "50 Hz")]
        for name in runs[0].ticks_10hz:
            both = [run.ticks_10hz[name] for run in runs], [run.ticks_50hz[name] for run in runs]
            rows.append((name, *(str(sum(ticks)) for ticks in both)))
        print(table(rows))
        lifted = sum(run.success for run in runs)
        home = sum(run.success and not run.fault for run in runs)
        shown = sum(run.held_as_shown for run in runs)
        print(
            f"of {len(runs)} runs: {lifted} lifted and held, {shown} as shown, {home} put down and home again"
        )

    def _known(self, header: dict[str, object]) -> list[WireRun]:
        """What a stopped series has done already."""
        if self.json is None or not self.json.exists():
            return []
        result = read_result(self.json)
        if any(result.header.get(key) != value for key, value in header.items()):
            raise FungraspError(f"{self.json} holds another series: give another name, or delete it")
        return [_read_run(row) for row in result.rows]


def _read_run(row: Row) -> WireRun:
    """A run as a table has it."""
    values: dict[str, Any] = {}
    for key, value in row.items():
        name, _, part = key.partition(".")
        if not part:
            values[name] = value
        elif value is not None:
            values.setdefault(name, {})[part] = value
    # Of a run in which nothing moved it is empty. Series of before say shares of a core as well.
    values.pop("cores", None)
    return WireRun(**{"longest_silence_ms": {}, **values})


def _line(run: WireRun) -> str:
    silence = " / ".join(f"{value:.0f}" for value in run.longest_silence_ms.values())
    outcome = f"{'' if run.success else 'not '}lifted, {100 * run.height_m:.1f} cm"
    ticks = f"latest tick {run.latest_10hz_ms:.1f} ms at 10 Hz, {run.latest_50hz_ms:.1f} ms at 50 Hz"
    return (
        f"twin {run.twin}: {outcome}{', then: ' * bool(run.fault)}{run.fault}; {ticks}; silent for "
        f"{silence} ms; the twin lost {run.twin_lost_ms:.0f} ms; {run.seconds:.0f} s"
    )


if __name__ == "__main__":
    main("wire", BenchWire)
