"""Times of a deployment, and how it went."""

from __future__ import annotations

from dataclasses import dataclass, field

from fungrasp.deployment.deadlines import DeadlineMonitor
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import PreparedGrasp


@dataclass(frozen=True)
class DeploymentSettings:
    """Times of a deployment."""

    look_time: float = 1.0
    """Time in which poses of the object are collected before planning [s]."""
    wait_time: float = 10.0
    """Longest wait for the first of them [s]."""
    put_down: bool = True
    """Whether the object is put down again, and the arm goes home."""
    open_time: float = 1.5
    """Time in which the hand opens to let go [s]."""
    longest_phase: float = 30.0
    """A phase that takes longer has failed [s]."""
    attempts: int = 1
    """Most attempts: where the object is seen not to be held, the hand withdraws, and another plan is made
    for the place where it lies. One attempt ends as it ends: nothing is judged."""


@dataclass(frozen=True, eq=False)
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
