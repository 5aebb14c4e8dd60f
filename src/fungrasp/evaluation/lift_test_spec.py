"""Settings of a lift test. They are sent to workers and stored in the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import radians
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord, record_from_json
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.sim2real import (
    NOMINAL,
    THREE_PUSHES,
    MeasurementError,
    ProtocolName,
    Randomization,
    protocol_conditions,
)
from fungrasp.simulation import SceneSettings
from fungrasp.task import LiftProtocol


@dataclass(frozen=True)
class WorldDifferences(CheckedRecord):
    """Differences of worlds from the belief of planner and policy, the same in every episode."""

    mass_scale: float = 1.0
    """Factor on the object's mass; the policy assumes the nominal mass."""
    friction: float | None = None
    """Sliding friction of hand, object and table. Default: 0.9."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Error of the estimated object pose: position [m] and rotation [degrees]."""
    table_height: float = 0.0
    """Height of the table top above the nominal height, which the policy assumes [m]."""
    latency: float = 0.0
    """Delay of actions [s], up to 0.1."""
    push: tuple[float, float] = (0.0, 0.2)
    """Three pushes in random directions during the hold: force [object weights] and duration [s]."""
    object_shift: float = 0.0
    """Distance that the object is moved on the table after planning [m]."""

    @property
    def randomization(self) -> Randomization:
        """The differences as a randomization.

        Raises:
            FungraspError: a number is invalid.
        """
        distance, angle = self.pose_noise
        weights, duration = self.push
        return Randomization(
            mass=(self.mass_scale, self.mass_scale),
            friction=None if self.friction is None else (self.friction, self.friction),
            object_position_error=MeasurementError(offset=distance),
            object_rotation_error=MeasurementError(offset=radians(angle)),
            table_height=(self.table_height, self.table_height),
            action_delay=(self.latency, self.latency),
            push_times=THREE_PUSHES if weights else (),
            push_weights=(weights, weights),
            push_duration=duration,
            object_shift=(self.object_shift, self.object_shift),
        )


@dataclass(frozen=True)
class LiftTestSpec(CheckedRecord):
    """Settings of a lift test; ``fungrasp.core.records`` converts them to and from JSON."""

    policy: str = "reference"
    """Policy that moves the hand: "reference" (one planned motion, open loop), "student", "teacher", "plan"
    (the student's plan, open loop), one of `fungrasp policies list`, or a policy file (.onnx)."""
    protocol: ProtocolName = "nominal"
    """Differences of worlds from the estimate: nominal (none), reality (all quantities, drawn per episode),
    robustness (one quantity at a time, in several conditions)."""
    seeds: tuple[int, ...] = (0,)
    """Random seeds; each grasp is tested once per seed."""
    randomization: Randomization = NOMINAL
    """Differences of worlds from the estimate, instead of a protocol."""
    lift: LiftProtocol = field(default_factory=LiftProtocol)
    """Parameters of the test. Default: the published ones."""
    physics: SceneSettings = field(default_factory=SceneSettings)
    """Settings of the engine."""
    adapt: bool = True
    """Adapt each grasp to the object after it has settled. This also repairs badly retargeted grasps;
    --no-adapt plays them unchanged."""
    rollouts: bool = True
    """If the policy selects among candidate plans, test them in randomized rollouts until one holds the
    object as shown: 3 to 104 episodes per grasp. Without rollouts, one motion per grasp is played."""
    other_places: bool = False
    """If no candidate plan holds the object as shown, play one that holds it in another way."""
    selection: SelectionSettings | None = None
    """Settings of the plan selection. None: suitable for protocol, rollouts and use."""
    attempts: int = 1
    """Maximum number of attempts. A policy with feedback (student) notices that the object is not held,
    withdraws, plans again and tries again. The published protocol is one attempt; with more, the result
    also has the success rate of the first."""
    use: bool = False
    """After the hold, play the motion of the task (tilt, strike, stroke, press, hand over) and report how
    many objects stay in place and are held as shown."""
    static: bool = False
    """Also measure the static quality, if the human grasps are known."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is invalid, or a protocol and a randomization are given.
        """
        super().__post_init__()
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise FungraspError("seeds needs at least one value, and each once")
        if min(self.seeds) < 0:
            raise FungraspError("a seed must not be negative")
        if self.protocol != "nominal" and self.randomization != NOMINAL:
            raise FungraspError(
                f"the protocol {self.protocol} already defines how worlds differ: leave out other differences"
            )
        from fungrasp.planning.attempts import check_attempts

        check_attempts(self.attempts, watches=True)

    @classmethod
    def read(cls, data: Any, where: str) -> LiftTestSpec | None:
        """Read the output of ``record_to_json``, also of earlier versions. Return None for settings that are
        not supported any more: grasps varied in the test's own world.

        Raises:
            FungraspError: the data are not settings of a lift test.
        """
        if not isinstance(data, Mapping):
            return record_from_json(cls, data, where)
        if data.get("refine"):
            return None
        data = {name: value for name, value in data.items() if name != "refine"}
        selection = data.get("selection")
        if isinstance(selection, Mapping):
            gone = ("grips", "grips_kept")
            data["selection"] = {name: value for name, value in selection.items() if name not in gone}
        return record_from_json(cls, data, where)

    @property
    def conditions(self) -> dict[str, Randomization]:
        """Randomizations by condition; the name of a single one is ""."""
        if self.randomization != NOMINAL:
            return {"": self.randomization}
        return protocol_conditions(self.protocol)

    @property
    def selection_settings(self) -> SelectionSettings:
        """``selection``, or suitable settings on the device of the physics."""
        if self.selection is not None:
            return self.selection
        settings = SelectionSettings.for_protocol(self.protocol, self.rollouts, self.use, self.other_places)
        return settings.on(self.physics.device, self.physics.buffers)
