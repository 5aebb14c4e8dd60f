"""How a search for a plan goes: how many candidates, which rollouts, when it is enough."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fungrasp.core.errors import FungraspError
from fungrasp.planning.selection.candidates import VariationSpread
from fungrasp.planning.selection.rollouts import RolloutSettings, Rounds
from fungrasp.sim2real import MODERATE, REALITY_ROLLOUTS, ProtocolName
from fungrasp.simulation import BufferSizes, Device

WIDE_SPREAD = VariationSpread(position=0.008, rotation=0.35, joints=0.06, closing=0.1, force=0.5, press=0.01)

OTHER_PLACES = 0.3
"""What is as shown in one rollout of three is preferred to what never is and always holds."""

GPU_CHUNK = 8192
"""Rollouts that a GPU makes together: about 1 GB of its memory."""


@dataclass(frozen=True)
class FurtherSearch:
    """Where no candidate is good enough, the best ones are varied again."""

    most: int = 3
    """Largest number of times that candidates are varied again."""
    enough: float = 0.6
    """Expected success from which a candidate is good enough."""
    parents: int = 3
    """Best candidates of a grasp that are varied, and kept beside the new ones."""
    spread: VariationSpread = WIDE_SPREAD
    """Spread of the variations."""
    rounds: Rounds = ((27, 1), (8, 2), (3, 3))
    """Rollouts of old and new candidates."""


@dataclass(frozen=True)
class SelectionSettings:
    """How many candidates there are, and how one is selected."""

    candidates: int = 24
    """Candidates of each grasp that are planned together, the unchanged grasp included."""
    rollouts: RolloutSettings | None = field(default_factory=RolloutSettings)
    """Rollouts that decide between the most promising; the predictor alone decides if None."""
    sure: float = 0.8
    """Expected success from which the best candidate after the first rollouts is taken without more."""
    first_rounds: Rounds = ((6, 1), (3, 2))
    """First rollouts of all grasps: a candidate that holds three times out of three is sure where the
    predictor expects two of three or more."""
    rounds: Rounds = ((12, 1), (6, 2), (3, 3))
    """Rollouts of the first candidates of grasps of which none is sure."""
    prior: float = 4.0
    """Number of rollouts that the predictor's expectation stands for."""
    search: FurtherSearch = field(default_factory=FurtherSearch)
    """What is done where the rollouts have found nothing that holds."""
    for_use: bool = False
    """Whether the use motions of the grasps' tasks count: the share of their loads that contacts can take in
    what is expected, and whether they are withstood in rollouts."""
    other_places: float = 0.0
    """What a plan that holds the object otherwise than shown counts, where one that is as shown counts one;
    ``OTHER_PLACES`` where such plans are allowed."""
    chunk: int = 512
    """Plans made together."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a number is too small.
        """
        if min(self.candidates, self.search.parents) < 1:
            raise FungraspError(f"there must be at least one plan to choose from, not {self}")
        for rounds in (self.first_rounds, self.rounds, self.search.rounds):
            if not rounds or min(number for pair in rounds for number in pair) < 1:
                raise FungraspError(f"rollouts need rounds of at least one plan and episode, not {rounds}")

    @classmethod
    def for_protocol(
        cls,
        protocol: ProtocolName,
        rollouts: bool = True,
        for_use: bool = False,
        other_places: bool = False,
    ) -> SelectionSettings:
        """Rollouts that know how far worlds may be from what is believed, and nothing of what was drawn.

        Args:
            protocol: of the evaluation; that of robustness tries what was not expected.
            rollouts: whether there are any.
            for_use: whether they go on with the use motions of the grasps' tasks.
            other_places: whether a plan may hold the object otherwise than shown where none as shown holds.
        """
        other = OTHER_PLACES if other_places else 0.0
        if not rollouts:
            return cls(rollouts=None, for_use=for_use, other_places=other)
        drawn = REALITY_ROLLOUTS if protocol == "reality" else MODERATE
        if not for_use:
            return cls(rollouts=RolloutSettings(drawn), other_places=other)
        # What holds, but withstands nothing, counts half; the search is to go on after it, although the
        # predictor, which knows lifts alone, expects much of it.
        # The use goes on with the hold.
        return cls(
            rollouts=RolloutSettings(drawn, for_use=True, hold_time=0.8),
            prior=2.0,
            first_rounds=((8, 1), (3, 2)),
            rounds=((10, 1), (3, 3)),
            search=FurtherSearch(most=1, enough=0.8, rounds=((16, 1), (5, 2), (2, 2))),
            for_use=True,
            other_places=other,
        )

    def on(self, device: Device, buffers: BufferSizes | None = None) -> SelectionSettings:
        """The same with rollouts on a device; a GPU makes those of many grasps together."""
        if self.rollouts is None or device == self.rollouts.device:
            return self
        chunk = GPU_CHUNK if device == "cuda" else self.rollouts.chunk
        moved = replace(self.rollouts, device=device, buffers=buffers, chunk=chunk)
        return replace(self, rollouts=moved, chunk=max(self.chunk, chunk))

    @property
    def rollouts_per_grasp(self) -> tuple[int, int]:
        """Fewest and most episodes that are simulated to plan one grasp."""
        if self.rollouts is None:
            return 0, 0
        first, second, again = (
            sum(a * b for a, b in rounds) for rounds in (self.first_rounds, self.rounds, self.search.rounds)
        )
        return first, first + second + self.search.most * again
