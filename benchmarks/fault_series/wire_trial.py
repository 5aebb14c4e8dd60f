"""A fault over emulated wires, on the clock of the wall: a deployment in a process of its own, which is
spoiled from outside."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np

from benchmarks.fault_series.moments import LOOK, Happened, PreparerOf, Scene, twin_world
from benchmarks.fault_series.trial import WATCHED, Drawn, FaultTrial, TruthWatch, judged
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.hold_after_stop import OPENING, HoldWatch, endings_as_interrupts
from fungrasp.deployment.log import McapLog
from fungrasp.deployment.spec import Phase
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.arms.ur import URSettings
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import DeviceSettings, RobotCell
from fungrasp.robots.hands.allegro import AllegroSettings
from fungrasp.robots.hands.inspire import InspireSettings
from fungrasp.robots.hands.leap import LeapSettings
from fungrasp.robots.twin.world import HoldSample, TwinWorld, held_throughout, hold_sample
from fungrasp_emulators.cell import CellEmulation
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.ur import URControllerEmulator

PRELOADED = ("benchmarks.fault_series.wire_trial", "mink")
"""What sessions import: a server that has done so forks them."""


class ControlProcess:
    """A session of control in a process of its own; a context manager that leaves none of its processes.

    It tells its drivers' processes as the message ``("drivers", (process of the arm's, of the hand's))``.
    """

    def __init__(self, run: Callable[..., None], task: object):
        """
        Args:
            run: main function of the process: takes the task and its end of a pipe.
        """
        # Forked, each session begins at once, without the threads of the emulators in this process.
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(PRELOADED))
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=run, args=(task, other), daemon=False)
        self._process.start()
        other.close()
        self._drivers: tuple[int | None, ...] = ()
        self.heard: dict[str, tuple[Any, ...]] = {}
        """The last message of each kind."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.signal(signal.SIGKILL)
        self._process.join()
        self._pipe.close()
        # Drivers end by themselves when their input ends; those of a killed computer have been killed.
        deadline = time.monotonic() + 10.0
        while any(map(_alive, self._drivers)) and time.monotonic() < deadline:
            time.sleep(0.01)
        self.kill_drivers()

    @property
    def alive(self) -> bool:
        """Whether the session runs; one that is stopped by a signal does."""
        return _alive(self._process.pid)

    def listen(self, timeout: float) -> None:
        """Hear what it says, for so long at most [s]."""
        try:
            while self._pipe.poll(timeout):
                what, *values = self._pipe.recv()
                self.heard[what] = tuple(values)
                if what == "drivers":
                    self._drivers = values[0]
                timeout = 0.0
        except (EOFError, OSError):
            # It was killed.
            time.sleep(timeout)

    def tell(self, what: str) -> None:
        """Send it a word; one that has ended does not hear it."""
        with contextlib.suppress(OSError):
            self._pipe.send(what)

    def signal(self, number: signal.Signals) -> None:
        """Send the session a signal, but not its drivers."""
        _signal(self._process.pid, number)

    def signal_driver(self, number: int, what: signal.Signals) -> None:
        """Send one of the drivers' processes a signal. number: 0 of the arm, 1 of the hand."""
        _signal(self._drivers[number], what)

    def kill_drivers(self) -> None:
        """End the drivers' processes at once (SIGKILL)."""
        for process in self._drivers:
            _signal(process, signal.SIGKILL)


def _signal(process: int | None, number: signal.Signals) -> None:
    # On a busy machine one may end by itself meanwhile.
    with contextlib.suppress(ProcessLookupError):
        if process is not None and _alive(process):
            os.kill(process, number)


def _alive(process: int | None) -> bool:
    """Whether a process runs; one that has ended and was not waited for does not."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in ("Z", "X")


@dataclass(frozen=True, eq=False)
class WireSession:
    """One deployment."""

    scene: Scene
    """What is deployed."""
    cell: RobotCell
    """Whose addresses are on the loopback."""
    log: Path
    """To write; it must not exist."""


def run_wire_session(session: WireSession, pipe: Connection) -> None:
    """Deploy, then hold until a word comes; the process's main function.

    Messages through the pipe: ``("drivers", (process of the arm's driver, of the hand's))``, ``(event,
    time)`` as each event comes, ``("ended", time, phase, what was wrong)``; times of ``time.monotonic`` [s].
    """
    scene = session.scene

    def happened(event: str) -> None:
        pipe.send((event, time.monotonic()))

    # As in a terminal; a process that is forked is deaf to it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with (
            McapLog(session.log) as log,
            wired_robot(session.cell, scene.hand) as robot,
            endings_as_interrupts(),
        ):
            drivers = robot.arm, robot.hand_driver
            pipe.send(("drivers", tuple(getattr(driver, "process_id", None) for driver in drivers)))
            deployment = Deployment(
                robot,
                OpenLoopPolicy(),
                PreparerOf(robot, scene.prepared, happened),
                observers=[log, Happened(happened)],
            )
            happened(LOOK)
            result = deployment.run(scene.grasp)
            pipe.send(("ended", time.monotonic(), result.phase.value, result.fault))
            words: list[str] = []
            # As a person would be asked: the hand holds meanwhile.
            watch = HoldWatch(robot, words.append)
            while not pipe.poll():
                with contextlib.suppress(KeyboardInterrupt):
                    watch.look()
            opened = not deployment.may_hold or watch.open()
            pipe.send(("opened", opened, " / ".join(words), len(watch.held_up) / len(scene.hand.actuators)))
    except (FungraspError, OSError, EOFError) as error:
        pipe.send(("ended", time.monotonic(), "", f"{type(error).__name__}: {error}"))


SAMPLE = 0.02
"""Time between two looks at the truth [s]."""
ONE_FINGER = 0.25
"""Share of a hand's joints that one finger has."""
LONGEST = 90.0
"""A deployment that takes longer has failed [s]."""


class FalseAlarm(Exception):
    """The deployment ended before its fault came, or for another reason though it was to go on: on a busy
    machine devices fall silent."""


class _HoldWatch:
    """Looks at a twin during the hold."""

    def __init__(self, world: TwinWorld):
        self._world, self._settled = world, float(world.center_of_mass()[2])
        self._samples: list[HoldSample] = []

    def look(self) -> None:
        self._samples.append(hold_sample(self._world, self._settled))

    @property
    def held(self) -> bool:
        """Whether the object was lifted and held throughout."""
        samples = self._samples
        # Looks at its first and last moment may come late.
        seconds = samples[-1].time - samples[0].time + 4 * SAMPLE if samples else 0.0
        return held_throughout(samples, seconds)


def wire_trial(scene: Scene, drawn: Drawn, patience: float) -> FaultTrial:
    """A deployment over emulated wires, with a fault.

    Args:
        drawn: the fault; one that is brought over the wire.
        patience: times the usual limits of silence.

    Raises:
        FalseAlarm: the deployment ended before, or for another reason though it was to go on.
        FungraspError: the cell can't be emulated.
    """
    cell = private_cell(scene.cell, patience)
    scene = replace(scene, cell=cell)
    world = twin_world(cell, scene.hand, scene.obj, scene.twin)
    world.settle(scene.placement)
    judge, event = _HoldWatch(world), drawn.after(scene)
    with (
        TemporaryDirectory(prefix="fungrasp-") as folder,
        CellEmulation(cell, world, scene.obj.name) as wires,
    ):
        task = WireSession(scene, cell, Path(folder) / "log.mcap")
        with ControlProcess(run_wire_session, task) as session:
            _until(session, judge, *event)
            watch = TruthWatch(world)
            watch.look()
            _bring(drawn, wires, session)
            ended = _ended(session, judge, watch, drawn, wires)
            silent = drawn.kind.said == "" or ended is None, "", 1.0
            opened, said, share = session.heard.get("opened", silent)
            # A finger may be held up by the table, or by what stands there.
            opened = opened or (share <= ONE_FINGER and world.look().on_table)
            reason = str(ended[2]) if ended else ""
            phase = Phase(ended[1]) if ended and ended[1] else (Phase.FAULT if ended else None)
    if phase is Phase.FAULT and drawn.may_go_on(scene) and not drawn.named(reason):
        raise FalseAlarm(reason)
    when = float(ended[0]) if ended else watch.times[0]
    return judged(
        scene,
        drawn,
        watch,
        ended=phase,
        when=when,
        reason=reason,
        lifted=judge.held,
        # The address is that of this run alone.
        said=str(said).replace(cell.hand_device.address, "its line"),
        opened=bool(opened),
    )


def _look(session: ControlProcess, judge: _HoldWatch) -> None:
    """Listen, and judge the hold."""
    session.listen(SAMPLE)
    if Phase.HOLD in session.heard and Phase.PUT_DOWN not in session.heard:
        judge.look()


def _until(session: ControlProcess, judge: _HoldWatch, event: str, after: float) -> None:
    """Wait until a time after an event [s]."""
    deadline = time.monotonic() + LONGEST
    while event not in session.heard or time.monotonic() < session.heard[event][0] + after:
        _look(session, judge)
        if "ended" in session.heard or not session.alive or time.monotonic() > deadline:
            ended = session.heard.get("ended")
            raise FalseAlarm(str(ended[2]) if ended else "it did not come so far")


def _bring(drawn: Drawn, wires: CellEmulation, session: ControlProcess) -> None:
    kind = drawn.kind
    if kind.fault is not None:
        (wires.arm if kind.device == "arm" else wires.hand).inject(kind.fault)
    elif kind.name == "speed slider":
        assert isinstance(wires.arm, URControllerEmulator)
        wires.arm.set_speed_slider(round(0.9 * drawn.amount, 2))
    elif kind.signals:
        for number in kind.signals:
            session.signal(number)
            time.sleep(0.5 * (len(kind.signals) > 1))
    elif kind.name == "pause of 0.45 s":
        session.signal(signal.SIGSTOP)
        time.sleep(0.45)
        session.signal(signal.SIGCONT)
    elif kind.name in ("hand's process killed", "hand's process frozen"):
        session.signal_driver(1, signal.SIGKILL if kind.name.endswith("killed") else signal.SIGSTOP)
    else:
        if kind.name == "computer without power":
            # They first: as the control process ends, each would switch its device off.
            session.kill_drivers()
        session.signal(signal.SIGKILL)


def _ended(
    session: ControlProcess, judge: _HoldWatch, watch: TruthWatch, drawn: Drawn, wires: CellEmulation
) -> tuple[float, str, str] | None:
    """How the deployment ended; None where it was killed. What is true is watched until some time after."""
    begun = time.monotonic()
    deadline, clears = begun + LONGEST, begun + drawn.kind.clears
    while "ended" not in session.heard and session.alive and time.monotonic() < deadline:
        _look(session, judge)
        watch.look()
        if time.monotonic() > clears:
            wires.hand.clear()
    rest = max(time.monotonic() + WATCHED, clears + 1.0 if np.isfinite(clears) else 0.0)
    while time.monotonic() < rest:
        time.sleep(SAMPLE)
        watch.look()
        if time.monotonic() > clears:
            wires.hand.clear()
    # What is said of the hand is of the fault; then it is over, and the hand must open.
    if drawn.kind.device == "hand" and drawn.kind.fault is not Fault.MOTOR:
        wires.hand.clear()
        time.sleep(1.0)
    session.tell("end")
    opening = time.monotonic() + 2 * OPENING + 4.0
    while "opened" not in session.heard and session.alive and time.monotonic() < opening:
        session.listen(SAMPLE)
    return session.heard.get("ended")  # pyright: ignore[reportReturnType]


USUAL = {
    "ur-rtde": URSettings.stale_after,
    "allegro-can": AllegroSettings.stale_after,
    "inspire": InspireSettings.stale_after,
    "leap-dynamixel": LeapSettings.stale_after,
}
"""Silence after which a device counts as disconnected, by driver [s]."""


def private_cell(cell: RobotCell, patience: float) -> RobotCell:
    """The cell with addresses that no other process has.

    Args:
        cell: of a UR arm with an Allegro or an Inspire hand.
        patience: times the usual limits of silence.

    Raises:
        FungraspError: the cell can't be emulated.
    """
    number = os.getpid()

    def patient(device: DeviceSettings, address: str) -> Any:
        said = device.options.get("stale_after", USUAL[device.driver])
        return replace(device, address=address, options={**device.options, "stale_after": patience * said})

    hands = {
        "allegro-can": str(20000 + number % 20000),
        "inspire": f"127.{number % 200 + 1}.0.5",
        "leap-dynamixel": f"/tmp/fungrasp-leap-{number}",
    }
    if cell.arm.driver != "ur-rtde" or cell.hand_device.driver not in hands:
        raise FungraspError(f"the devices of cell '{cell.name}' can't be emulated for this")
    dog = cell.watchdog
    return replace(
        cell,
        arm=patient(cell.arm, f"127.{number % 200 + 1}.0.4"),
        hand_device=patient(cell.hand_device, hands[cell.hand_device.driver]),
        tracker=replace(cell.tracker, address=f"ipc:///tmp/fungrasp-control-{number}"),
        watchdog=replace(
            dog,
            arm_silence=patience * dog.arm_silence,
            hand_silence=patience * dog.hand_silence,
            overrun=patience * dog.overrun,
            pose_stale=patience * dog.pose_stale,
        ),
    )
