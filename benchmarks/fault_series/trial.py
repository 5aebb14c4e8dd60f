"""One fault in one deployment: what was true afterwards, and whether it was as it should be."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.fault_series.fault_kinds import FaultKind
from benchmarks.fault_series.moments import Moment, Scene
from fungrasp.deployment.phases import Phase
from fungrasp.robots.twin.world import TwinWorld

WATCHED = 2.0
"""What is true is looked at for so long after the reaction [s]."""
RESTING = 0.5
"""The arm is at rest if the palm stays where it is over the last part of that time [s]."""
STILL = 1e-3
"""It stays where it is if it moves by less [m]."""
SUNK = 0.02
"""An object is still held if it has sunk by less [m]: fingers and arm yield."""


@dataclass(frozen=True)
class Drawn:
    """A fault that was drawn."""

    number: int
    """Of the series."""
    moment: Moment
    """When it comes."""
    share: float
    """Of that part of the deployment, 0 to 1."""
    kind: FaultKind
    """What comes."""
    amount: float
    """How much of it, 0 to 1: the speed slider's place."""

    def after(self, scene: Scene) -> tuple[str, float]:
        """The event that it comes after, and how long after it [s]."""
        span = scene.spans[self.moment]
        return span.event, span.after + self.share * span.length

    def named(self, reason: str) -> bool:
        """Whether a reason is the fault's."""
        return bool(self.kind.said) and re.search(self.kind.said, reason) is not None

    def may_go_on(self, scene: Scene) -> bool:
        """Whether the grasp may go on to its end: the fault changes nothing then, or would be seen so late
        that it changes nothing any more."""
        kind, order = self.kind, list(Moment)
        following = order[min(order.index(self.moment) + 1, len(order) - 1)]
        rest = (1.0 - self.share) * scene.spans[self.moment].length
        return self.moment in kind.carried or (following in kind.carried and rest < kind.reaction(scene.cell))


@dataclass(frozen=True)
class FaultTrial:
    """What came of it."""

    cell: str
    """Name of the cell."""
    number: int
    """Of the series."""
    twin: int
    """Which twin."""
    object: str
    """Name of the object."""
    moment: str
    """When the fault came."""
    share: float
    """Of that part of the deployment."""
    fault: str
    """What came; "none" where the deployment ended before."""
    place: str
    """"twin" or "wire"."""
    carried: bool
    """Whether the grasp went on to its end."""
    named: bool
    """Whether the reason was the fault's."""
    reason: str
    """Why the robot stopped."""
    at_rest: bool
    """Whether the arm was at rest at the end."""
    distance_m: float
    """How far the palm went on after the fault [m]; -1 where the grasp was to go on."""
    limit_m: float
    """How far it may go on [m]."""
    held_before: bool
    """Whether the hand alone held the object as the fault came."""
    held_after: bool
    """Whether it still held it at the end."""
    lets_go: bool
    """Whether this hand can't keep its hold then."""
    success: bool
    """Whether all was as it should be."""
    false_alarms: str = ""
    """Why deployments with this fault ended for a reason that is not the fault's, and were begun anew."""


@dataclass
class TruthWatch:
    """Looks at a twin from a fault on."""

    world: TwinWorld
    """The twin."""
    times: list[float] = field(default_factory=list)
    """[s]"""
    palms: list[np.ndarray] = field(default_factory=list)
    """Positions [m], each of shape [3]."""
    heights: list[float] = field(default_factory=list)
    """Of the object's center of mass [m]."""
    in_hand: list[bool] = field(default_factory=list)
    """Whether it touches the hand."""
    on_table: list[bool] = field(default_factory=list)
    """Whether it touches anything else."""

    def look(self) -> None:
        """Look now."""
        truth = self.world.look()
        self.times.append(self.world.time)
        self.palms.append(truth.palm_pose[:3])
        self.heights.append(float(self.world.center_of_mass()[2]))
        self.in_hand.append(truth.in_hand)
        self.on_table.append(truth.on_table)


def judged(
    scene: Scene,
    drawn: Drawn,
    watch: TruthWatch,
    *,
    ended: Phase | None,
    when: float,
    reason: str,
    lifted: bool,
) -> FaultTrial:
    """What came of a fault.

    Args:
        ended: where the deployment ended; None where nobody is left to say so.
        when: it ended [s]; of use where the fault is a gradual one.
        lifted: whether the object was lifted and held throughout the hold.
    """
    kind, cell = drawn.kind, scene.cell
    times, palms = np.array(watch.times), np.array(watch.palms)
    begin = 0
    if kind.gradual:
        begin = max(int(np.searchsorted(times, when - kind.reaction(cell))) - 1, 0)
    went = np.linalg.norm(palms[begin:] - palms[begin], axis=1)
    last = palms[times > times[-1] - RESTING]
    resting = bool(np.linalg.norm(last - last[-1], axis=1).max() < STILL)
    before = watch.in_hand[begin] and not watch.on_table[begin]
    after = watch.in_hand[-1] and watch.heights[-1] > watch.heights[begin] - SUNK
    lets_go = cell.hand in kind.lets_go
    carried = ended is Phase.DONE
    named = drawn.named(reason) if ended is not None else not kind.said
    distance = -1.0 if carried else float(went.max())
    stopped = resting and distance <= kind.limit(cell) and (after or not before or lets_go)
    # What may be carried may also be noticed: then the robot stops as it should.
    good = (lifted and drawn.may_go_on(scene)) if carried else (named and stopped)
    return replace(
        no_fault_came(scene, drawn, reason),
        fault=kind.name,
        carried=carried,
        named=named,
        at_rest=resting,
        distance_m=distance,
        limit_m=kind.limit(cell),
        held_before=before,
        held_after=after,
        lets_go=lets_go,
        success=bool(good),
    )


def no_fault_came(scene: Scene, drawn: Drawn, reason: str) -> FaultTrial:
    """A deployment that ended before its fault came. reason: why it did."""
    return FaultTrial(
        cell=scene.cell.name,
        number=drawn.number,
        twin=scene.twin,
        object=scene.thing.name,
        moment=drawn.moment.value,
        share=drawn.share,
        fault="none",
        place=drawn.kind.place.value,
        carried=False,
        named=False,
        reason=reason,
        at_rest=True,
        distance_m=-1.0,
        limit_m=0.0,
        held_before=False,
        held_after=False,
        lets_go=False,
        success=False,
    )
