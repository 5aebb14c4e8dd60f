"""Result of a deployment, and timing of its loop."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fungrasp.deployment.preparation import PreparedGrasp
from fungrasp.deployment.spec import DeploymentSpec, Phase
from fungrasp.grasps.as_shown import AsShown


@dataclass
class DeadlineMonitor:
    """Collects how late ticks begin."""

    late_tick: float
    """Lateness beyond which a tick counts as late [s]."""
    lateness: list[float] = field(default_factory=list)
    """Lateness of each tick [s]."""

    def record(self, planned: float, now: float) -> float:
        """Add a tick that was planned for a time [s] and begins now [s]; return its lateness [s]."""
        late = max(0.0, now - planned)
        self.lateness.append(late)
        return late

    @property
    def late(self) -> int:
        """Number of ticks that were late."""
        return int(np.sum(np.array(self.lateness) > self.late_tick))

    def summary(self) -> str:
        """Return a summary in one line."""
        if not self.lateness:
            return "no tick"
        ms = 1e3 * np.array(self.lateness)
        return (
            f"{len(ms)} ticks, late by {np.median(ms):.2f} ms (median), {np.percentile(ms, 99):.2f} ms "
            f"(99 %), {ms.max():.2f} ms (largest); {self.late} later than {1e3 * self.late_tick:g} ms"
        )


@dataclass(frozen=True, eq=False, repr=False)
class DeploymentResult:
    """Result of a deployment."""

    spec: DeploymentSpec
    """The settings."""
    phase: Phase
    """DONE or FAULT."""
    fault: str
    """Reason of a fault, as a phrase; "" without fault."""
    prepared: PreparedGrasp | None
    """The plan; None if none was made."""
    ticks: DeadlineMonitor
    """Lateness of the 10 Hz ticks."""
    setpoints: DeadlineMonitor
    """Lateness of the 50 Hz setpoints."""
    attempts: int = 1
    """Attempts made."""
    missed: bool = False
    """Whether the robot noticed that the last of several attempts failed."""
    why_no_more: str = ""
    """Why an allowed further attempt was not made, else empty."""
    times: dict[str, float] = field(default_factory=dict)
    """Start of each phase on the robot's clock [s]."""
    longest_silence: dict[str, float] = field(default_factory=dict)
    """Longest time that the time stamp of arm and hand stood still between setpoints [s]."""
    success: bool | None = None
    """Whether the object was lifted and held, for twins only."""
    height: float = np.nan
    """Smallest height of the object's center of mass during the hold [m], for twins; infinite without a
    hold."""
    as_shown: AsShown | None = None
    """How the hand held the object, one row, for twins. None without a hold, or if the person's contacts are
    unknown."""

    @property
    def held_as_shown(self) -> bool | None:
        """Whether the object was held as shown, for twins; None if ``success`` is None."""
        if self.success is None:
            return None
        return self.success and self.as_shown is not None and bool(self.as_shown.holds[0])

    def __repr__(self) -> str:
        return f"<DeploymentResult: {self.words()}>"

    def words(self) -> str:
        """Return a summary in one line."""
        if self.fault:
            return f"fault: {self.fault}"
        no_more = f"; no further attempt: {self.why_no_more}" if self.why_no_more else ""
        if self.success is None:
            missed = f"not held, as far as is seen, after {self.attempts} attempts"
            return (missed if self.missed else "done") + no_more
        if not self.success:
            return f"not lifted{no_more}"
        by = f", by attempt {self.attempts}" if self.attempts > 1 else ""
        shown = ""
        if self.as_shown is not None:
            shown = ", as shown" if self.held_as_shown else f", not as shown: {self.as_shown.reason[0]}"
        return f"lifted and held at {100 * self.height:.1f} cm{by}{shown}"
