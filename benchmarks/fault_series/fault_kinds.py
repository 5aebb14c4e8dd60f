"""What may go wrong with a deployment, when, and what should come of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from benchmarks.fault_series.moments import Moment
from fungrasp.robots.arms.ur import URSettings
from fungrasp.robots.cell import RobotCell
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
    hands: tuple[str, ...] = ("allegro", "inspire")
    """Hands of cells in which it may come."""

    def limit(self, cell: RobotCell) -> float:
        """Farthest that the palm may go on [m]: its largest speed, for as long as it takes to react and to
        brake."""
        return cell.limits.palm_speed * (self.reaction(cell) + BRAKING)


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


ARM_GONE = r"(the arm|UR\d+ at) .*(disconnected|silent|stands still|cable)"
HAND_GONE = r"(the hand|Allegro|RH56) .*(disconnected|silent|answer)"
LATER = tuple(moment for moment in ALL if moment not in TRACKED)

KINDS = (
    FaultKind("arm silent", Place.TWIN, "the arm has been silent|arm.*silent", _arm_silence, MOVING),
    FaultKind("hand silent", Place.TWIN, "the hand has been silent", _hand_silence, MOVING),
    FaultKind("fault of the hand", Place.TWIN, "the hand .*motor hot"),
    FaultKind("tracker jumps", Place.TWIN, "has jumped by", _tracker, carried=LATER),
    FaultKind(
        "tracker silent",
        Place.TWIN,
        "the tracked pose is .* old",
        lambda cell: cell.watchdog.pose_stale + 2 * CONTROL_PERIOD,
        carried=LATER,
    ),
    FaultKind("disk full", Place.TWIN, "the log can't be written: No space left", _control, ALL[1:]),
    FaultKind("Ctrl-C", Place.TWIN, "Ctrl-C"),
    FaultKind("stop key", Place.TWIN, "the stop key was pressed"),
    FaultKind("error in the policy", Place.TWIN, "ZeroDivisionError: made up", _control, POLICY),
    FaultKind("policy returns NaN", Place.TWIN, "not finite", _control, POLICY),
    FaultKind(
        "computer hangs", Place.TWIN, "the control period was overrun", lambda c: 4 * CONTROL_PERIOD, POLICY
    ),
    FaultKind("emergency stop", Place.WIRE, "emergency stop", device="arm", fault=Fault.EMERGENCY_STOP),
    FaultKind("protective stop", Place.WIRE, "protective stop", device="arm", fault=Fault.PROTECTIVE_STOP),
    FaultKind("safeguard stop", Place.WIRE, "safeguard stop", device="arm", fault=Fault.SAFEGUARD_STOP),
    FaultKind("speed slider", Place.WIRE, "% of its speed", _arm_silence),
    FaultKind("arm's network lost", Place.WIRE, ARM_GONE, _watchdog, device="arm", fault=Fault.STALLED),
    FaultKind("arm's controller gone", Place.WIRE, ARM_GONE, _watchdog, device="arm", fault=Fault.KILLED),
    FaultKind(
        "hand's line lost",
        Place.WIRE,
        HAND_GONE,
        _driver_silence,
        lets_go=("allegro",),
        device="hand",
        fault=Fault.STALLED,
    ),
    FaultKind(
        "bus off",
        Place.WIRE,
        "(the hand|Allegro V.) .*bus is off",
        _driver_silence,
        lets_go=("allegro",),
        device="hand",
        fault=Fault.BUS_OFF,
        hands=("allegro",),
    ),
    FaultKind(
        "error frames",
        Place.WIRE,
        "",
        carried=ALL,
        gradual=True,
        device="hand",
        fault=Fault.BUS_ERRORS,
        hands=("allegro",),
    ),
    FaultKind(
        "answers corrupt",
        Place.WIRE,
        HAND_GONE,
        _driver_silence,
        carried=ALL,
        gradual=True,
        device="hand",
        fault=Fault.CORRUPT,
        hands=("inspire",),
    ),
    FaultKind(
        "connection reset",
        Place.WIRE,
        HAND_GONE,
        _driver_silence,
        carried=ALL,
        gradual=True,
        device="hand",
        fault=Fault.RESET,
        hands=("inspire",),
    ),
    FaultKind("kill -9", Place.WIRE, "", _watchdog, lets_go=("allegro",)),
    FaultKind("computer without power", Place.WIRE, "", _watchdog, lets_go=("allegro",)),
)
