"""A fault over emulated wires, on the clock of the wall."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.fault_series.control_process import ControlProcess
from benchmarks.fault_series.moments import Scene, twin_world
from benchmarks.fault_series.trial import WATCHED, Drawn, FaultTrial, TruthWatch, judged
from benchmarks.fault_series.wire_session import WireSession, run_wire_session
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.phases import Phase
from fungrasp.robots.cell import DeviceSettings, RobotCell
from fungrasp.robots.twin.judge import HoldSample, held_throughout, hold_sample
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import LiftProtocol
from fungrasp_emulators.cell import CellEmulation
from fungrasp_emulators.ur import URControllerEmulator

SAMPLE = 0.02
"""Time between two looks at the truth [s]."""
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
        return held_throughout(samples, seconds, LiftProtocol())


def wire_trial(scene: Scene, drawn: Drawn, patience: float) -> FaultTrial:
    """A deployment over emulated wires, with a fault.

    Args:
        scene: without it.
        drawn: the fault; one that is brought over the wire.
        patience: times the usual limits of silence.

    Raises:
        FalseAlarm: the deployment ended before, or for another reason though it was to go on.
        FungraspError: the cell can't be emulated.
    """
    cell = private_cell(scene.cell, patience)
    scene = replace(scene, cell=cell)
    world = twin_world(cell, scene.hand, scene.thing, scene.twin)
    world.settle(scene.placement)
    judge, event = _HoldWatch(world), drawn.after(scene)
    with (
        TemporaryDirectory(prefix="fungrasp-") as folder,
        CellEmulation(cell, world, scene.thing.name) as wires,
    ):
        task = WireSession(scene, cell, Path(folder) / "log.mcap")
        with ControlProcess(run_wire_session, task) as session:
            _until(session, judge, *event)
            watch = TruthWatch(world)
            watch.look()
            _bring(drawn, wires, session)
            ended = _ended(session, judge, watch, drawn)
            reason = str(ended[2]) if ended else ""
            phase = Phase(ended[1]) if ended and ended[1] else (Phase.FAULT if ended else None)
    if phase is Phase.FAULT and drawn.may_go_on(scene) and not drawn.named(reason):
        raise FalseAlarm(reason)
    when = float(ended[0]) if ended else watch.times[0]
    return judged(scene, drawn, watch, ended=phase, when=when, reason=reason, lifted=judge.held)


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
    else:
        if kind.name == "computer without power":
            # They first: as the control process ends, each would switch its device off.
            session.kill_drivers()
        session.signal(signal.SIGKILL)


def _ended(
    session: ControlProcess, judge: _HoldWatch, watch: TruthWatch, drawn: Drawn
) -> tuple[float, str, str] | None:
    """How the deployment ended; None where it was killed. What is true is watched until some time after."""
    deadline = time.monotonic() + LONGEST
    while "ended" not in session.heard and session.alive and time.monotonic() < deadline:
        _look(session, judge)
        watch.look()
    rest = time.monotonic() + WATCHED
    while time.monotonic() < rest:
        time.sleep(SAMPLE)
        watch.look()
    session.tell("end")
    return session.heard.get("ended")  # pyright: ignore[reportReturnType]


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
        options = dict(device.options)
        if "stale_after" in options:
            options["stale_after"] *= patience
        return replace(device, address=address, options=options)

    hands = {"allegro-can": str(20000 + number % 20000), "inspire": f"127.{number % 200 + 1}.0.5"}
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
        ),
    )
