"""What is asked of a deployment, its times, and how it went."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fungrasp.deployment.deadlines import DeadlineMonitor
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import PreparedGrasp
from fungrasp.robots.robot_state import RobotState

Until = Literal["plan", "approach", "grasp", "lift", "put-down", "home"]
"""Where a deployment ends."""

LAST_PHASES: dict[Until, Phase] = {
    "plan": Phase.IDLE,
    "approach": Phase.MOVE_TO_START,
    "grasp": Phase.GRASP,
    "lift": Phase.HOLD,
    "put-down": Phase.PUT_DOWN,
    "home": Phase.HOME,
}
"""The last phase of each."""


@dataclass(frozen=True)
class DeploymentSpec:
    """What is asked of a deployment, as JSON by ``fungrasp.core.records``."""

    cell: str = "ur5e-allegro"
    """A robot cell: one that comes with the package (`fungrasp robots list`), or a TOML file."""
    policy: str = "plan"
    """What moves the hand: "plan", "reference" (planned motions, open loop), "student", or a policy file."""
    attempts: int = 1
    """Most attempts. A policy that watches (a student) sees that the object is not held: the hand withdraws,
    looks where the object lies, plans anew and tries again."""
    until: Until = "home"
    """Where to end: "plan" (nothing moves), "approach" (at the start of the grasp), "grasp" (fingers closed),
    "lift" (after the hold, with the object held), "put-down" or "home"."""
    speed: float = 1.0
    """Share of the cell's speed, above 0 and at most 1: the time of all motion is stretched."""
    dry_run: bool = False
    """Read everything, decide everything, log everything, and send nothing."""
    gravity_compensation: bool = True
    """Carry the hand's weight; else it sags."""
    hand_dynamics: str = ""
    """File of the hand's identified dynamics (`fungrasp identify fit`); what the cell names if empty."""
    seed: int = 0
    """Of the plan."""
    twin: int = 0
    """For a twin: which one, 0, 1, 2 ... Its true parameters are hidden."""
    real_time: bool = True
    """For a twin: run on the clock of the wall; else as fast as it goes, the same to the last bit."""


@dataclass(frozen=True)
class DeploymentSettings:
    """Times of a deployment."""

    look_time: float = 1.0
    """Time in which poses of the object are collected before planning [s]."""
    wait_time: float = 10.0
    """Longest wait for the first of them [s]."""
    until: Phase = Phase.HOME
    """The last phase: IDLE, MOVE_TO_START, GRASP, HOLD, PUT_DOWN or HOME. The robot ends where it is then."""
    speed: float = 1.0
    """Share of the cell's speed, above 0 and at most 1: time of the plan is stretched, as ``Robot.slow_down``
    says. The hold takes its time."""
    open_time: float = 1.5
    """Time in which the hand opens to let go [s]."""
    longest_phase: float = 30.0
    """A phase that takes longer has failed [s]."""
    attempts: int = 1
    """Most attempts: where the object is seen not to be held, the hand withdraws, and another plan is made
    for the place where it lies. One attempt ends as it ends: nothing is judged."""


@dataclass(frozen=True, eq=False, repr=False)
class DeploymentResult:
    """How a deployment went."""

    phase: Phase
    """DONE, or FAULT."""
    fault: str
    """Why it is FAULT, as a phrase; "" otherwise."""
    prepared: PreparedGrasp | None
    """What was planned; None where it did not come to that."""
    ticks: DeadlineMonitor
    """Lateness of the 10 Hz ticks."""
    setpoints: DeadlineMonitor
    """Lateness of the 50 Hz setpoints."""
    attempts: int = 1
    """Attempts made."""
    missed: bool = False
    """Whether the last of several attempts was seen not to hold the object."""
    why_no_more: str = ""
    """Why no further attempt was made though it was allowed; empty if that was not so."""
    times: dict[str, float] = field(default_factory=dict)
    """When each phase began, on the robot's clock [s]."""
    longest_silence: dict[str, float] = field(default_factory=dict)
    """Longest time that the time stamp of arm and hand stood still between setpoints [s]."""
    before: RobotState | None = None
    """What the devices said before planning; None where it did not come to that."""
    spec: DeploymentSpec | None = None
    """What was asked, where ``fungrasp.deploy`` was."""
    success: bool | None = None
    """Whether the object was lifted and held, in truth: of a twin. Nobody knows it of a robot."""
    height: float = np.nan
    """Least height of the object's center of mass during the hold [m], of a twin; infinite without a hold."""

    def __repr__(self) -> str:
        return f"<DeploymentResult: {self.words()}>"

    def words(self) -> str:
        """How it went, in a line; the fault where there was one."""
        if self.fault:
            return f"fault: {self.fault}"
        no_more = f"; no further attempt: {self.why_no_more}" if self.why_no_more else ""
        if self.success is None:
            missed = f"not held, as far as is seen, after {self.attempts} attempts"
            return (missed if self.missed else "done") + no_more
        if not self.success:
            return f"not lifted{no_more}"
        by = f", by attempt {self.attempts}" if self.attempts > 1 else ""
        return f"lifted and held at {100 * self.height:.1f} cm{by}"
