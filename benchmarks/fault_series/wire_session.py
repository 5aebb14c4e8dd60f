"""A deployment over emulated wires in a process of its own, for faults from outside."""

from __future__ import annotations

import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from benchmarks.fault_series.moments import LOOK, Happened, PreparerOf, Scene
from benchmarks.faults.control_session import driver_process
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.log import McapLog
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.process_priority import raise_priority


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

    raise_priority()
    try:
        with McapLog(session.log) as log, wired_robot(session.cell, scene.hand) as robot:
            pipe.send(("drivers", (driver_process(robot.arm), driver_process(robot.hand_driver))))
            deployment = Deployment(
                robot,
                OpenLoopPolicy(),
                PreparerOf(robot, scene.prepared, happened),
                observers=[log, Happened(happened)],
            )
            happened(LOOK)
            result = deployment.run(scene.grasp)
            pipe.send(("ended", time.monotonic(), result.phase.value, result.fault))
            # As a person would be asked: the hand holds meanwhile.
            pipe.recv()
    except (FungraspError, OSError, EOFError) as error:
        pipe.send(("ended", time.monotonic(), "", f"{type(error).__name__}: {error}"))
