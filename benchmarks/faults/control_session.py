"""A short deployment in a process of its own, to be spoiled: the arm sways up and down and the fingers open
and close at the start of a plan, through the loop, safety filter, log and drivers of every deployment."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.log import McapLog
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import PreparedGrasp
from fungrasp.deployment.spec import DeploymentSpec
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import JointDriver
from fungrasp.robots.process_priority import raise_priority
from fungrasp.task import Action, GraspPlan, Observation

PERIOD = 3.0
"""Of the motion [s]: the palm's limits of speed and acceleration are nearly reached."""
RISE = 0.12
"""Of the palm [m]."""
CLOSING = 0.5
"""Of the fingers' joints [rad]."""


class ControlFault(StrEnum):
    """What may go wrong with the computer that controls a robot."""

    POLICY_NAN = "policy returns NaN"
    """What it answers is not finite."""
    DISK_FULL = "disk full"
    """The log can't grow any more."""
    HUNG = "control process hangs"
    """It is stopped (SIGSTOP), its drivers run on."""
    KILLED = "control process killed"
    """SIGKILL; its drivers' processes live."""
    ALL_KILLED = "control and drivers killed"
    """SIGKILL to all of them at once, as when the computer loses power: nobody is left to send anything."""


INSIDE = (ControlFault.POLICY_NAN, ControlFault.DISK_FULL)
"""Faults that the session brings upon itself; the others come from outside."""


@dataclass(frozen=True, eq=False)
class ControlSession:
    """One session."""

    cell: RobotCell
    """Whose addresses are on the loopback."""
    grasp: RobotGraspSet
    """One; its object is what the tracker sees."""
    prepared: PreparedGrasp
    """The plan, at whose start the arm stands."""
    log: Path
    """To write; it must not exist."""
    fault: ControlFault | None
    """That this session brings upon itself; None for none."""
    after: float
    """When, since the motion began [s]."""


def run_session(session: ControlSession, pipe: Connection) -> None:
    """Run a session; the process's main function.

    Messages through the pipe: ``("drivers", (process of the arm's driver, of the hand's))``, ``("moving",
    time)``, ``("fault", time)`` as it brings its fault, ``("ended", time, what was wrong, time of the
    reaction)``; times of ``time.monotonic`` [s].
    """
    cell = session.cell
    hand = load_hand(cell.hand)

    class Moving(DeploymentObserver):
        def phase(self, time: float, phase: Phase) -> None:
            if phase is Phase.GRASP:
                pipe.send(("moving", monotonic()))

    raise_priority()
    wrong, reacted = "", np.nan
    try:
        with McapLog(session.log) as log, wired_robot(cell, hand) as robot:
            pipe.send(("drivers", (driver_process(robot.arm), driver_process(robot.hand_driver))))
            policy = _Sway(session, pipe)
            preparer = _Prepared(session.prepared)
            spec = DeploymentSpec(look_time=0.2, until="lift")
            deployment = Deployment(robot, policy, preparer, spec, [log, Moving()])
            result = deployment.run(session.grasp)
            wrong, reacted = result.fault, result.times.get(Phase.FAULT, np.nan)
    except (FungraspError, OSError) as error:
        wrong = wrong or f"{type(error).__name__}: {error}"
    pipe.send(("ended", monotonic(), wrong, reacted))


def driver_process(driver: JointDriver) -> int | None:
    """The process of a driver; None where it has none of its own."""
    return driver.process_id if isinstance(driver, LoopDriver) else None


class _Prepared:
    """A ``Preparer`` that has its plan already, for one attempt."""

    objects: Mapping[str, ObjectModel] = {}

    def __init__(self, prepared: PreparedGrasp):
        self._prepared = prepared

    def prepare(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0
    ) -> PreparedGrasp:
        return self._prepared


class _Sway:
    """A policy that moves to and fro, and brings the session's fault."""

    def __init__(self, session: ControlSession, pipe: Connection):
        self._session, self._pipe, self._brought = session, pipe, False
        self._palm = self._fingers = np.zeros(0)

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        self._palm, self._fingers = observation.palm_setpoint.copy(), observation.joint_setpoints.copy()

    def act(self, observation: Observation) -> Action:
        share = 0.5 - 0.5 * np.cos(2 * np.pi * observation.time[0] / PERIOD)
        goal = self._palm.copy()
        goal[:, 2] += RISE * share
        fingers = self._fingers + CLOSING * share
        session = self._session
        if session.fault is not None and observation.time[0] >= session.after:
            if not self._brought:
                self._brought = True
                self._pipe.send(("fault", monotonic()))
                if session.fault is ControlFault.DISK_FULL:
                    _fill_the_disk(session.log)
            if session.fault is ControlFault.POLICY_NAN:
                goal *= np.nan
        return Action(goal, fingers, np.array([False]))


def _fill_the_disk(log: Path) -> None:
    """No file of this process may grow beyond what the log has now."""
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    with contextlib.suppress(OSError):
        resource.setrlimit(resource.RLIMIT_FSIZE, (log.stat().st_size, most))
