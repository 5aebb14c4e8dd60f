"""``fungrasp robots doctor | read | touch | hold | jog``: test one device of a cell at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from fungrasp.cli.console import Answering, CommandResult
from fungrasp.cli.options import CellName, ask_before_motion, wired_cell
from fungrasp.core.errors import FungraspError, UnknownNameError

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.robots.cell import RobotCell
    from fungrasp.robots.single_devices import GuardedDriver

STILL = {"arm": 0.005, "hand": 0.06}
"""Largest motion of a holding joint [rad]; the servos of hands are less stiff than those of arms."""

COMPARED = 2.0
"""Longest wait for an arm driver's comparison with its controller [s]."""


@dataclass(frozen=True)
class OfCell(Answering):
    """Arguments of commands for a cell."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""


@dataclass(frozen=True)
class OfDevice(OfCell):
    """Arguments of commands for one device."""

    part: Annotated[Literal["arm", "hand"], tyro.conf.Positional]
    """The device."""


@dataclass(frozen=True)
class Doctor(OfCell):
    """Connect to each device of a cell and report whether it answers. Nothing moves."""

    def run(self) -> CommandResult:
        from fungrasp.robots.single_devices import examine_devices

        reports = []
        for report in examine_devices(*wired_cell(self.cell)):
            print(report.words, flush=True)
            reports.append(report)
        ill = sum(not report.well for report in reports)
        return CommandResult(
            [{"device": report.words, "well": report.well} for report in reports],
            fault=f"{ill} of 3 devices can't be used" if ill else "",
        )


@dataclass(frozen=True)
class Read(OfDevice):
    """Print the measured joint positions of an arm or a hand. Nothing moves."""

    seconds: float = 10.0
    """Duration [s]."""

    def run(self) -> CommandResult:
        from fungrasp.robots.single_devices import bare_driver, joint_names, read_joints

        cell, hand = wired_cell(self.cell)
        names = joint_names(self.part, cell, hand)
        states = []
        with bare_driver(self.part, cell, hand) as driver:
            for state in read_joints(driver, self.seconds):
                states.append({"status": str(state.status), "positions": state.positions})
                joints = "  ".join(f"{n} {q:.3f}" for n, q in zip(names, state.positions, strict=True))
                print(f"{state.status}  {joints} rad", flush=True)
        return CommandResult({"joints": names, "states": states})


@dataclass(frozen=True)
class Touch(OfCell):
    """Record a known point that the robot touches now, for `robots check --touched` and `robots bring-up
    --touched`. Guide the arm there by hand (freedrive). Nothing moves by itself."""

    file: Annotated[Path, tyro.conf.Positional]
    """JSON file to write or extend."""
    at: tuple[float, float, float]
    """The known point, in the world frame of the cell [m]."""
    hand_point: tuple[float, float, float] | None = None
    """Point of the hand that touches, in the hand frame (see `pose_flange_hand`) [m]. Default: the center of
    the flange touches."""

    def run(self) -> CommandResult:
        import numpy as np

        from fungrasp.robots.calibration.touched import TouchedPoint, add_touched, touched_place
        from fungrasp.robots.single_devices import arm_at_rest

        cell, hand = wired_cell(self.cell)
        if not np.isfinite([*self.at, *(self.hand_point or ())]).all():
            raise FungraspError("a point needs 3 finite numbers")
        touched = TouchedPoint(tuple(arm_at_rest(cell, hand).tolist()), self.at, self.hand_point)
        apart = np.array(self.at) - touched_place(touched, cell, hand)
        count = add_touched(self.file, touched)
        x, y, z = np.round(1e3 * apart) + 0.0
        what = "flange" if self.hand_point is None else "hand"
        text = (
            f"{self.file}: {count} points of the {what}; this one is ({x:.0f}, {y:.0f}, {z:.0f}) mm from "
            "where the cell file puts it"
        )
        return CommandResult({"touched": self.file, "count": count, "apart": apart}, text)


@dataclass(frozen=True)
class Hold(OfDevice):
    """Switch on an arm or a hand and hold its position. A device that moves now is not ready."""

    seconds: float = 5.0
    """Duration [s]."""
    yes: bool = False
    """Do not ask first; for emulated devices only."""

    def run(self) -> CommandResult:
        from fungrasp.robots.single_devices import hold_in_place

        cell, hand = wired_cell(self.cell)
        what = f"hold the {self.part} where it is for {self.seconds:g} s"
        with _moving(self.part, cell, hand, what, self.yes) as driver:
            driver.take_control()
            said, end = driver.read().message, monotonic() + COMPARED
            while self.part == "arm" and not said and monotonic() < end:
                sleep(0.02)
                said = driver.read().message
            if said:
                print(said, flush=True)
            moved = hold_in_place(driver, self.seconds)
        text, most = f"held within {moved:.3f} rad", STILL[self.part]
        fault = f"it moved by {moved:.3f} rad, but {most:g} rad is allowed" if moved > most else ""
        return CommandResult({"moved": moved}, text, fault)


@dataclass(frozen=True)
class Jog(OfDevice):
    """Move one joint of an arm or a hand slowly by a small angle and back, while the others hold."""

    joint: Annotated[str, tyro.conf.Positional]
    """Name of the joint (see `robots read`), or "all" for one after the other, away from the nearer limit."""
    by: float = 0.1
    """Angle [rad], at most 0.2."""
    yes: bool = False
    """Do not ask first; for emulated devices only."""

    def run(self) -> CommandResult:
        from fungrasp.robots.device import SafetyStop
        from fungrasp.robots.single_devices import after_stop, joint_names

        cell, hand = wired_cell(self.cell)
        names = joint_names(self.part, cell, hand)
        if self.joint not in (*names, "all"):
            raise UnknownNameError("joint", self.joint, names)
        what = f"move '{self.joint}' of the {self.part} by {self.by:g} rad and back"
        moved, wrong = [], []
        with _moving(self.part, cell, hand, what, self.yes) as driver:
            for number in range(len(names)) if self.joint == "all" else [names.index(self.joint)]:
                try:
                    found, why = self._moved(driver, number, names[number])
                except SafetyStop as stop:
                    return CommandResult({"joint": names[number]}, after_stop(driver), fault=stop.reason)
                moved.append(found)
                wrong += why
        value = moved if self.joint == "all" else moved[0]
        return CommandResult(value, fault="; ".join(wrong))

    def _moved(self, driver: GuardedDriver, number: int, name: str) -> tuple[dict[str, Any], list[str]]:
        """Move one joint. Return measurements and faults."""
        import numpy as np

        from fungrasp.robots.single_devices import jog

        rest, limits, by = driver.read().positions, driver.limits, self.by
        room = limits.upper[number] - rest[number] > rest[number] - limits.lower[number]
        by = -by if self.joint == "all" and not room else by
        far, back = jog(driver, number, by)
        there, here = (float(state.positions[number] - rest[number]) for state in (far, back))
        others = float(np.abs(np.delete(far.positions - back.positions, number)).max(initial=0.0))
        print(f"{name}: moved by {there:.3f} rad, and back to {here:.3f} rad from the start", flush=True)
        wrong = []
        if abs(there - here - by) >= 0.5 * abs(by):
            wrong.append(f"{name} should move by {by:+.2f} rad and moved by {there - here:+.3f}")
        if max(others, abs(here)) >= STILL[self.part]:
            wrong.append(f"{name}: other joints moved by {others:.3f} rad, this one is {here:+.3f} rad off")
        return {"joint": name, "moved": there, "back": here}, wrong


@contextmanager
def _moving(part: str, cell: RobotCell, hand: Hand, what: str, yes: bool) -> Iterator[GuardedDriver]:
    """Ask, then connect to a device that will move.

    Args:
        part: "arm" or "hand".
        what: motion, as a phrase for the question.
        yes: whether to skip the question.
    """
    from fungrasp.robots.cell import is_wired
    from fungrasp.robots.single_devices import guarded_driver
    from fungrasp.robots.stop_switch import StopSwitch

    if yes and is_wired(cell):
        raise FungraspError("a real robot moves only after you confirm: --yes is for emulated devices")
    with StopSwitch(cell.stop_file, keyboard=True) as switch:
        if not yes:
            ask_before_motion(switch, what)
        with guarded_driver(part, cell, hand, switch) as driver:
            yield driver
