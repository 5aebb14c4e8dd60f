"""Whether the loop keeps its time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class DeadlineMonitor:
    """Collects how late ticks begin."""

    late_tick: float
    """A tick that is later than this counts as late [s]."""
    lateness: list[float] = field(default_factory=list)
    """Of each tick [s]."""

    def record(self, planned: float, now: float) -> float:
        """A tick begins.

        Args:
            planned: when it should have begun [s].
            now: [s].

        Returns:
            how late it is [s].
        """
        late = max(0.0, now - planned)
        self.lateness.append(late)
        return late

    @property
    def late(self) -> int:
        """Number of ticks that were late."""
        return int(np.sum(np.array(self.lateness) > self.late_tick))

    def summary(self) -> str:
        """One line."""
        if not self.lateness:
            return "no tick"
        ms = 1e3 * np.array(self.lateness)
        return (
            f"{len(ms)} ticks, late by {np.median(ms):.2f} ms (median), {np.percentile(ms, 99):.2f} ms "
            f"(99 %), {ms.max():.2f} ms (largest); {self.late} later than {1e3 * self.late_tick:g} ms"
        )
