"""What may go wrong with a deployment, when, and what should come of it; whether it did."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from benchmarks.fault_series.moments import Moment, Scene
from fungrasp.deployment.spec import Phase
from fungrasp.robots.arms.ur import URSettings
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task.setpoints import SETPOINT_PERIOD
from fungrasp_emulators.emulator import Fault

BRAKING = 0.1
"""An arm at its largest speed is at rest after this time [s]."""
TRACKER = 0.25
"""A tracker's delay and two of its frames [s]: what it sees is heard of so much later."""
CONTROL_PERIOD = 0.1
"""Between two looks at the tracker and the log [s]."""
WATCHDOG = 1.0 / URSettings.watchdog
"""Time after which a UR controller ends a program that it hears nothing of [s]."""

ALL = tuple(Moment)
MOVING = ALL[2:]
POLICY = (Moment.APPROACH, Moment.CLOSE, Moment.LIFT, Moment.HOLD)
"""Where the policy acts."""
TRACKED = (Moment.LOOK, Moment.PLAN, Moment.START, Moment.APPROACH)
"""Where the tracked pose counts."""


class Place(StrEnum):
    """Where a fault is brought."""

    TWIN = "twin"
    """On the twin's own clock, without a wire."""
    WIRE = "wire"
    """Over emulated wires, with loop, drivers and log in processes of their own."""


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault."""

    name: str
    """For tables."""
    place: Place
    """Where it is brought."""
    said: str
    """What the reason must hold, a regular expression; "" where nobody is left to say it."""
    reaction: Callable[[RobotCell], float] = lambda cell: SETPOINT_PERIOD
    """Longest time from the fault until the arm brakes [s]."""
    moments: tuple[Moment, ...] = ALL
    """When it may come."""
    carried: tuple[Moment, ...] = ()
    """When it should change nothing: the grasp goes on to its end."""
    gradual: bool = False
    """Whether it need not be noticed where it begins: what counts is from when the robot stopped."""
    lets_go: tuple[str, ...] = ()
    """Hands that can't keep their hold then: the computer makes their torques."""
    device: str = ""
    """What shows ``fault``: "arm" or "hand" of the emulation; "" where something else does it."""
    fault: Fault | None = None
    """Of the emulated device."""
    clears: float = np.inf
    """After so long the fault ends by itself [s]."""
    signals: tuple[signal.Signals, ...] = ()
    """That come to the deployment's process, half a second apart."""
    hands: tuple[str, ...] = ("allegro", "inspire", "leap")
    """Hands of cells in which it may come."""

    def limit(self, cell: RobotCell) -> float:
        """Farthest that the palm may go on [m]: its largest speed, for as long as it takes to react and to
        brake."""
        return cell.limits.palm_speed * (self.reaction(cell) + BRAKING)


def _setpoint(cell: RobotCell) -> float:
    return SETPOINT_PERIOD


def _arm_silence(cell: RobotCell) -> float:
    return cell.watchdog.arm_silence + SETPOINT_PERIOD


def _hand_silence(cell: RobotCell) -> float:
    # The driver tells of a hand that is silent, or the guard does: whoever is sooner.
    return cell.watchdog.hand_silence + SETPOINT_PERIOD


def _control(cell: RobotCell) -> float:
    return CONTROL_PERIOD + SETPOINT_PERIOD


def _tracker(cell: RobotCell) -> float:
    return TRACKER + CONTROL_PERIOD


def _driver_silence(cell: RobotCell) -> float:
    said = float(cell.hand_device.options.get("stale_after", 0.1))
    return max(said, cell.watchdog.hand_silence) + CONTROL_PERIOD


def _watchdog(cell: RobotCell) -> float:
    return max(WATCHDOG, cell.watchdog.arm_silence) + SETPOINT_PERIOD


def _stale_pose(cell: RobotCell) -> float:
    return cell.watchdog.pose_stale + 2 * CONTROL_PERIOD


def _hanging(cell: RobotCell) -> float:
    return 4 * CONTROL_PERIOD


def _paused(cell: RobotCell) -> float:
    return 0.45 + CONTROL_PERIOD


def _asked(cell: RobotCell) -> float:
    # An Allegro is asked for its faults once a second.
    return 1.0 + CONTROL_PERIOD


def _errors_read(cell: RobotCell) -> float:
    # Of a hand's motors they are read twice a second or more often.
    return 0.5 + CONTROL_PERIOD


ARM_GONE = r"(the arm|UR\d+ at) .*(disconnected|silent|stands still|cable)"
HAND_GONE = r"(the hand|Allegro|RH56) .*(disconnected|silent|answer)"
LATER = tuple(moment for moment in ALL if moment not in TRACKED)


def _hand(name: str, fault: Fault, said: str = HAND_GONE, **more: Any) -> FaultKind:
    return FaultKind(name, Place.WIRE, said, _driver_silence, device="hand", fault=fault, **more)


def _unnoticed(
    name: str, fault: Fault, hands: tuple[str, ...] = FaultKind.hands, said: str = ""
) -> FaultKind:
    """A fault of the hand that is ridden out, or noticed after a while."""
    return _hand(name, fault, said, carried=ALL, gradual=True, hands=hands)


def _arm(name: str, fault: Fault, said: str, reaction: Callable[[RobotCell], float] = _setpoint) -> FaultKind:
    return FaultKind(name, Place.WIRE, said, reaction, device="arm", fault=fault)


def _signal(name: str, said: str, *signals: signal.Signals) -> FaultKind:
    return FaultKind(name, Place.WIRE, said, _control, signals=signals)


BUS_IS_OFF = "(the hand|Allegro V.) .*bus is off"
ALLEGRO, INSPIRE, LEAP = ("allegro",), ("inspire",), ("leap",)

KINDS = (
    FaultKind("arm silent", Place.TWIN, "the arm has been silent|arm.*silent", _arm_silence, MOVING),
    FaultKind("hand silent", Place.TWIN, "the hand has been silent", _hand_silence, MOVING),
    FaultKind("fault of the hand", Place.TWIN, "the hand .*motor hot"),
    FaultKind("tracker jumps", Place.TWIN, "has jumped by", _tracker, carried=LATER),
    FaultKind("tracker silent", Place.TWIN, "the tracked pose is .* old", _stale_pose, carried=LATER),
    FaultKind("disk full", Place.TWIN, "the log can't be written: No space left", _control, ALL[1:]),
    FaultKind("Ctrl-C", Place.TWIN, "Ctrl-C"),
    FaultKind("stop key", Place.TWIN, "the stop key was pressed"),
    FaultKind("error in the policy", Place.TWIN, "ZeroDivisionError: made up", _control, POLICY),
    FaultKind("policy returns NaN", Place.TWIN, "not finite", _control, POLICY),
    FaultKind("computer hangs", Place.TWIN, "the control period was overrun", _hanging, POLICY),
    _arm("emergency stop", Fault.EMERGENCY_STOP, "emergency stop"),
    _arm("protective stop", Fault.PROTECTIVE_STOP, "protective stop"),
    _arm("safeguard stop", Fault.SAFEGUARD_STOP, "safeguard stop"),
    FaultKind("speed slider", Place.WIRE, "% of its speed", _arm_silence),
    _arm("arm's network lost", Fault.STALLED, ARM_GONE, _watchdog),
    _arm("arm's controller gone", Fault.KILLED, ARM_GONE, _watchdog),
    _hand("hand's line lost", Fault.STALLED),
    _hand("hand frozen for 3 s", Fault.STALLED, clears=3.0),
    _hand("bus off", Fault.BUS_OFF, BUS_IS_OFF, hands=ALLEGRO),
    _hand("bus off for 0.5 s", Fault.BUS_OFF, BUS_IS_OFF, clears=0.5, hands=ALLEGRO),
    _unnoticed("error frames", Fault.BUS_ERRORS, ALLEGRO),
    _unnoticed("frames refused", Fault.NO_BUFFERS, ALLEGRO),
    _unnoticed("answers corrupt", Fault.CORRUPT, INSPIRE, said=HAND_GONE),
    _unnoticed("connection reset", Fault.RESET, INSPIRE, said=HAND_GONE),
    _unnoticed("writes unheard", Fault.UNHEARD),
    replace(_hand("hand too hot", Fault.TOO_HOT, "too hot", lets_go=ALLEGRO, hands=ALLEGRO), reaction=_asked),
    replace(
        _hand("motor fault", Fault.MOTOR, "motor fault|overload", lets_go=LEAP, hands=INSPIRE + LEAP),
        reaction=_errors_read,
    ),
    FaultKind("hand's process killed", Place.WIRE, "process has ended|disconnected", _driver_silence),
    FaultKind("hand's process frozen", Place.WIRE, HAND_GONE, _driver_silence),
    _signal("Ctrl-C once", "Ctrl-C", signal.SIGINT),
    _signal("Ctrl-C twice", "Ctrl-C", signal.SIGINT, signal.SIGINT),
    _signal("Ctrl-C three times", "Ctrl-C", signal.SIGINT, signal.SIGINT, signal.SIGINT),
    _signal("terminal closed", "SIGHUP", signal.SIGHUP),
    _signal("kill", "SIGTERM", signal.SIGTERM),
    FaultKind("pause of 0.45 s", Place.WIRE, "overrun|silent|disconnected", _paused, MOVING, MOVING),
    FaultKind("kill -9", Place.WIRE, "", _watchdog, lets_go=ALLEGRO),
    FaultKind("computer without power", Place.WIRE, "", _watchdog, lets_go=ALLEGRO),
)

WATCHED = 2.0
"""What is true is looked at for so long after the reaction [s]."""
RESTING = 0.5
"""The arm is at rest if the palm stays where it is over the last part of that time [s]."""
STILL = 1e-3
"""It stays where it is if it moves by less [m]."""
SUNK = 0.02
"""An object is still held if it has sunk by less below the palm [m]: fingers yield."""


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
    said: str
    """What was said of arm and hand while they held."""
    opened: bool
    """Whether the hand opened when it was told to, or could not be told."""
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
    said: str = "",
    opened: bool = True,
) -> FaultTrial:
    """What came of a fault.

    Args:
        ended: where the deployment ended; None where nobody is left to say so.
        when: it ended [s]; of use where the fault is a gradual one.
        lifted: whether the object was lifted and held throughout the hold.
        said: of arm and hand while they held.
        opened: whether the hand opened when it was told to.
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
    # The arm goes on a little, and what it holds goes with it.
    above = np.array(watch.heights) - palms[:, 2]
    after = watch.in_hand[-1] and bool(above[-1] > above[begin] - SUNK)
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
        said=said,
        opened=opened,
        success=bool(good) and opened,
    )


def no_fault_came(scene: Scene, drawn: Drawn, reason: str) -> FaultTrial:
    """A deployment that ended before its fault came. reason: why it did."""
    return FaultTrial(
        cell=scene.cell.name,
        number=drawn.number,
        twin=scene.twin,
        object=scene.obj.name,
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
        said="",
        opened=True,
        success=False,
    )
