"""Settings of the search for plans: candidates, rollouts, stopping."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord
from fungrasp.sim2real import MODERATE, NOMINAL, REALITY_ROLLOUTS, ProtocolName, Randomization
from fungrasp.simulation import BufferSizes, Device


@dataclass(frozen=True)
class VariationSpread(CheckedRecord):
    """Spread of the variations: standard deviations unless stated otherwise."""

    position: float = 0.004
    """Standard deviation of the wrist's shift along each axis [m]."""
    rotation: float = 0.15
    """Standard deviation of the wrist's turn about each axis through the mean of the target contacts
    [rad]."""
    joints: float = 0.03
    """Standard deviation of each joint, independently [rad]."""
    closing: float = 0.05
    """Standard deviation of the relative change of all joint angles [fraction]."""
    force: float = 0.4
    """Standard deviation of the logarithm of the squeeze."""
    press: float = 0.006
    """Range of the wrist's press beyond its target [m]."""


WIDE_SPREAD = VariationSpread(position=0.008, rotation=0.35, joints=0.06, closing=0.1, force=0.5, press=0.01)

OTHER_PLACES = 0.3
"""Weight of holds that are not as shown: a candidate that is as shown in one of three rollouts is preferred
to one that always holds but never as shown."""

GPU_CHUNK = 8192
"""Parallel rollouts on a GPU; they need about 1 GB of memory."""


@dataclass(frozen=True)
class RolloutSettings(CheckedRecord):
    """Settings of rollouts."""

    randomization: Randomization = MODERATE
    """Randomization of rollouts; the policy does not see it."""
    timestep: float = 0.01
    """Physics step [s]."""
    hold_time: float = 1.0
    """Duration of the hold [s]: a third of the lift test's, which finds the same plans faster."""
    rehearsal: int = 3
    """Period of full rollouts: every n-th rollout of a candidate covers the whole motion, with the timestep
    and hold of the lift test. Half of the plans that failed after short rollouts only dropped the object late
    or touched it on the way."""
    rehearsed: Randomization = NOMINAL
    """Randomization of full rollouts. Default: the believed world."""
    early: int = 2
    """Number of control steps before closing at which rollouts begin; they begin with the approach if it is
    not free (``approach_path.BLOCKED``)."""
    share: float = 0.2
    """Weight of the shown share relative to success."""
    contact: float = 0.1
    """Weight of the contact ratio relative to success."""
    slip: float = 0.01
    """Weight of the slip relative to success [s/mm]."""
    for_use: bool = False
    """Whether rollouts continue with the use motion of the grasp's task. A rollout that holds but fails the
    use motion counts 0.5 to ``rollouts.NEARLY_WITHSTOOD``."""
    chunk: int = 512
    """Parallel rollouts."""
    device: Device = "cpu"
    """Device of the rollouts."""
    buffers: BufferSizes | None = None
    """Contact buffers on a GPU; determined by a probe if None."""


@dataclass(frozen=True)
class SelectionSettings(CheckedRecord):
    """Settings of the search for a plan.

    The best-ranked candidate is tested until it holds the object as shown in ``confirmations`` rollouts in a
    row. Failures lower its rank. If no candidate succeeds, the best are varied again, more widely:
    ``searches`` times, and up to ``more_searches`` times more while even the best one often fails.
    """

    candidates: int = 8
    """First candidates of each grasp, including the unchanged grasp."""
    rollouts: RolloutSettings | None = field(default_factory=RolloutSettings)
    """Settings of rollouts. None: use the first candidate without rollouts."""
    confirmations: int = 3
    """Number of rollouts, all as shown, that confirm a candidate."""
    searches: int = 3
    """Largest number of further searches while no candidate is confirmed."""
    more_searches: int = 9
    """Largest number of searches after these, while the best candidate is expected to hold the object as
    shown in less than ``search.PASSED`` of the worlds."""
    more: int = 24
    """Candidates per further search."""
    parents: int = 3
    """Number of best candidates to vary."""
    spread: VariationSpread = WIDE_SPREAD
    """Spread of variations in further searches."""
    for_use: bool = False
    """Whether rollouts continue with the use motions of the grasps' tasks."""
    other_places: float = 0.0
    """Value of a hold that is not as shown, relative to one that is; ``OTHER_PLACES`` if such plans are
    allowed."""
    chunk: int = 512
    """Plans computed in parallel."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a number is too small.
        """
        super().__post_init__()
        numbers = self.candidates, self.confirmations, self.more, self.parents
        if min(numbers) < 1 or min(self.searches, self.more_searches) < 0:
            raise FungraspError(
                f"there must be at least one plan to choose from, and one rollout, not {self}"
            )

    @classmethod
    def for_protocol(
        cls,
        protocol: ProtocolName,
        rollouts: bool = True,
        for_use: bool = False,
        other_places: bool = False,
    ) -> SelectionSettings:
        """Return settings whose rollouts have the protocol's uncertainty, but not its sampled parameters.

        Args:
            protocol: protocol of the evaluation; for "robustness", the rollouts stay moderate.
            rollouts: whether to use rollouts.
            for_use: whether rollouts continue with the use motions of the grasps' tasks.
            other_places: whether a plan may hold the object in another way if none holds it as shown.
        """
        other = OTHER_PLACES if other_places else 0.0
        if not rollouts:
            return cls(rollouts=None, for_use=for_use, other_places=other)
        rolled, most = RolloutSettings(), cls.more_searches
        if protocol == "reality":
            # Short rollouts are too optimistic: they find 56 % as shown, the test finds 43 %. Longer searches
            # would keep a robot waiting for minutes.
            most = 0
            rolled = RolloutSettings(REALITY_ROLLOUTS, rehearsal=1, rehearsed=REALITY_ROLLOUTS)
        if not for_use:
            return cls(rollouts=rolled, more_searches=most, other_places=other)
        # The use motion prolongs the hold. One further search: if it fails, later ones rarely help.
        use = replace(rolled, for_use=True, hold_time=0.8)
        return cls(rollouts=use, searches=1, more_searches=0, for_use=True, other_places=other)

    def on(self, device: Device, buffers: BufferSizes | None = None) -> SelectionSettings:
        """Return the settings for a device; a GPU runs the rollouts of many grasps together."""
        if self.rollouts is None or device == self.rollouts.device:
            return self
        chunk = GPU_CHUNK if device == "cuda" else self.rollouts.chunk
        moved = replace(self.rollouts, device=device, buffers=buffers, chunk=chunk)
        return replace(self, rollouts=moved, chunk=max(self.chunk, chunk))

    @property
    def rollouts_per_grasp(self) -> tuple[int, int]:
        """Smallest and largest number of simulated episodes per grasp."""
        if self.rollouts is None:
            return 0, 0
        return self.confirmations, self.budget(0) + (self.searches + self.more_searches) * self.budget(1)

    def budget(self, search: int) -> int:
        """Return the largest number of rollouts of a grasp in the first search (0) or a further one: one per
        candidate, and two full sets of confirmations."""
        return (self.more if search else self.candidates) + 2 * self.confirmations
