"""The whole chain over the wire: deployments on emulated devices in another process, on the clock of the
wall."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.processor_time import processor_time
from benchmarks.twins.twin_episode import deploy_where_reached
from benchmarks.wire.emulation_worker import EmulationProcess, EmulationRecord, EmulationTask
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deploy import deploy_on_robot
from fungrasp.deployment.deployment_result import DeadlineMonitor, DeploymentResult
from fungrasp.deployment.deployment_task import DeploymentTask
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import UnreachableError
from fungrasp.deployment.twin_deployment import reachable_placements
from fungrasp.robots.device import JointDriver
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.judge import held_throughout
from fungrasp.task import LiftProtocol

EDGES_MS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Edges of the histogram of lateness [ms]."""


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
    cores: dict[str, float]
    """Processor time by time, of the processes: control (planning included), arm driver, hand driver,
    emulators."""
    placements: int = 0
    """Placements of the object; of all but the last the robot said that it can't reach the grasp."""
    seconds: float = 0.0
    """The whole run took, from placing the object on [s]."""
    images: int = 0
    """Images that were looked at, those of low confidence included; 0 where the grasp is not from one."""
    grasp_seconds: float = 0.0
    """From the image, or the file of grasps, to the robot grasp [s]."""
    attempts: int = 0
    """Of the robot at the object; success is of the last."""

    @property
    def refused(self) -> bool:
        """Whether the robot said that it can't reach the grasp, and nothing moved."""
        return self.phase == Phase.IDLE


def run_over_the_wire(task: DeploymentTask, twin: int) -> WireRun:
    """Start emulators with a twin in another process and deploy on them.

    Args:
        task: its cell's addresses are on the loopback.
        twin: which one.

    Returns:
        how it went. Where the robot says that it can't reach the grasp, the object is put elsewhere, as a
        person would do; after ``MOST_PLACEMENTS`` the run ends idle, with what is in the way as its fault.

    Raises:
        FungraspError: the emulators can't be started, or a device does not answer.
    """
    began = time.monotonic()
    placements = reachable_placements(task.cell, task.hand, task.thing, task.grasp, task.spec.seed)
    run, count, said = deploy_where_reached(placements, lambda placement: _run_at(task, twin, placement))
    seconds = time.monotonic() - began
    if run is None:
        return _not_begun(task, twin, said, count, seconds)
    return replace(run, placements=count, seconds=seconds)


def _run_at(task: DeploymentTask, twin: int, placement: np.ndarray) -> WireRun:
    """A run with the object at a placement, shape [7]."""
    meter = _ProcessMeter()
    with EmulationProcess(EmulationTask(task.cell, task.thing, placement, twin)) as process:
        try:
            result = deploy_on_robot(task, [meter])
        except UnreachableError:
            process.end()
            raise
        except FungraspError as error:
            process.end()
            raise FungraspError(f"twin {twin}: {error}") from error
        record = process.end()
    held = _held(result, record)
    cores = {**meter.cores(), "emulators": record.processor_time / record.seconds}
    return WireRun(
        object=task.thing.name,
        twin=twin,
        success=bool(held) and held_throughout(held, held[-1].time - held[0].time, LiftProtocol()),
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
        cores=cores,
        attempts=result.attempts,
    )


def _not_begun(task: DeploymentTask, twin: int, fault: str, placements: int, seconds: float) -> WireRun:
    """A run in which nothing moved."""
    none = DeadlineMonitor(0.0)
    return WireRun(
        object=task.thing.name,
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
        cores={},
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


class _ProcessMeter(DeploymentObserver):
    """Processor time of this process and of the drivers', from the first motion to the end."""

    def __init__(self) -> None:
        self._drivers: dict[str, JointDriver] = {}
        self._began: tuple[float, dict[str, float]] | None = None
        self._cores: dict[str, float] = {}

    def connected(self, robot: Robot) -> None:
        """See ``DeploymentObserver.connected``."""
        self._drivers = {"arm driver": robot.arm, "hand driver": robot.hand_driver}

    def hold(self, robot: Robot) -> bool:
        """See ``DeploymentObserver.hold``: nobody is there."""
        return True

    def phase(self, time: float, phase: Phase) -> None:
        """See ``DeploymentObserver.phase``."""
        self._note(phase)

    def fault(self, time: float, reason: str) -> None:
        """See ``DeploymentObserver.fault``."""
        self._note(Phase.FAULT)

    def _note(self, phase: Phase) -> None:
        now = time.monotonic(), self._times()
        if phase is Phase.MOVE_TO_START:
            self._began = now
        elif phase in (Phase.DONE, Phase.FAULT) and self._began is not None:
            elapsed = now[0] - self._began[0]
            self._cores = {name: (value - self._began[1][name]) / elapsed for name, value in now[1].items()}

    def cores(self) -> dict[str, float]:
        """Share of a core by process; empty where nothing has moved."""
        return self._cores

    def _times(self) -> dict[str, float]:
        times = {"control": time.process_time()}
        for name, driver in self._drivers.items():
            times[name] = processor_time(getattr(driver, "process_id", None))
        return times
