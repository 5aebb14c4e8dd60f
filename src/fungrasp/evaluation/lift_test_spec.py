"""How grasps are tried: the request of a lift test, made in Python or read from JSON, sent to workers, and
kept in the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.formats.record_json import record_from_json
from fungrasp.planning.attempts import check_attempts
from fungrasp.planning.selection import SelectionSettings
from fungrasp.sim2real import NOMINAL, ProtocolName, Randomization, protocol_conditions
from fungrasp.simulation import SceneSettings
from fungrasp.task import LiftProtocol


@dataclass(frozen=True)
class LiftTestSpec:
    """What is asked of a lift test. ``fungrasp.core.formats.record_json`` makes it JSON and reads it back."""

    policy: str = "reference"
    """Name or file of what moves the hand (``fungrasp.policies.policy_files``)."""
    protocol: ProtocolName = "nominal"
    """How worlds differ from what planner and policy believe: not at all; in everything at once; or in one
    thing at a time, which makes several conditions."""
    seeds: tuple[int, ...] = (0,)
    """Of everything that is random: each grasp is tried once with each."""
    randomization: Randomization = NOMINAL
    """How worlds differ, in the place of a protocol that is not nominal."""
    lift: LiftProtocol = field(default_factory=LiftProtocol)
    """Numbers of the test; the published ones by default."""
    physics: SceneSettings = field(default_factory=SceneSettings)
    """Settings of the engine."""
    adapt: bool = True
    """Whether the planner fits grasps to the object as it has settled."""
    rollouts: bool = True
    """Whether policies that choose among candidate plans try them in simulated rollouts first."""
    selection: SelectionSettings | None = None
    """How plans are chosen among candidates; what suits protocol, rollouts and use if None."""
    attempts: int = 1
    """Most attempts of an episode: a policy that watches tries again, by another plan, where it is seen to
    have failed. The published protocol is one."""
    use: bool = False
    """Whether the use test of the grasp's task follows every lift test that is passed."""
    static: bool = False
    """Whether the static quality is measured too, where the human grasps are known."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a number that can't be, an unknown protocol, or a randomization beside one.
        """
        if self.protocol not in get_args(ProtocolName):
            raise UnknownNameError("protocol", self.protocol, get_args(ProtocolName))
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise FungraspError("--seed needs at least one value, and each once")
        if min(self.seeds) < 0:
            raise FungraspError("--seed must not be negative")
        if self.protocol != "nominal" and self.randomization != NOMINAL:
            raise FungraspError(
                f"--protocol {self.protocol} says how worlds differ: give it or single options"
            )
        check_attempts(self.attempts, watches=True)

    @classmethod
    def read(cls, data: Any, where: str) -> LiftTestSpec | None:
        """What ``record_to_json`` has written, of earlier versions too. None where it can't be asked again:
        its grasps were varied in the test's own world first.

        Args:
            data: as read.
            where: begins the messages.

        Raises:
            FungraspError: it is no such thing.
        """
        if not isinstance(data, Mapping):
            return record_from_json(cls, data, where)
        if data.get("refine"):
            return None
        return record_from_json(cls, {k: v for k, v in data.items() if k != "refine"}, where)

    @property
    def conditions(self) -> dict[str, Randomization]:
        """What worlds are drawn from, by the name of the condition, "" where there is only one."""
        if self.randomization != NOMINAL:
            return {"": self.randomization}
        return protocol_conditions(self.protocol)

    @property
    def selection_settings(self) -> SelectionSettings:
        """``selection``, or what suits the rest, on the device of the physics."""
        if self.selection is not None:
            return self.selection
        settings = SelectionSettings.for_protocol(self.protocol, self.rollouts, self.use)
        return settings.on(self.physics.device, self.physics.buffers)
