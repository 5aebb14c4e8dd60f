"""``fungrasp robots doctor | read | hold | jog``: devices one by one, before anything is grasped."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.robots.cell import RobotCell
    from fungrasp.robots.device import JointDriver
    from fungrasp.robots.guarded_driver import GuardedDriver
    from fungrasp.robots.stop_switch import StopSwitch

CellName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
Part = Annotated[Literal["arm", "hand"], tyro.conf.Positional]

PARTS = ("arm", "hand")
"""Devices of a cell that move."""


@dataclass(frozen=True)
class Doctor:
    """Connect to each device of a cell in turn and say whether it answers. Nothing moves."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""

    def run(self) -> None:
        from fungrasp.errors import FungraspError
        from fungrasp.robots.assembly import pose_source
        from fungrasp.robots.device import DeviceStatus

        cell, hand = _wired(self.cell)
        ill = 0
        for name in PARTS:
            try:
                with _driver(name, cell, hand) as driver:
                    state = driver.read()
                well = state.status is DeviceStatus.READY
                print(f"{name}: {driver.name}, {state.status} {state.message}".rstrip())
                if driver.lets_go:
                    print(f"{name}: lets go of an object {driver.lets_go}")
            except FungraspError as error:
                well = False
                print(f"{name}: {error}")
            ill += not well
        try:
            with pose_source(cell) as tracker:
                seen = tracker.read()
            print(f"tracker: {tracker.name}, {'nothing seen' if seen is None else seen.status}")
        except FungraspError as error:
            ill += 1
            print(f"tracker: {error}")
        if ill:
            raise FungraspError(f"{ill} of 3 devices can't be used")


@dataclass(frozen=True)
class Read:
    """Show the joints of an arm or a hand, as they are measured. Nothing moves."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    part: Part
    """Which device."""
    seconds: float = 10.0
    """For so long [s]."""

    def run(self) -> None:
        import time

        cell, hand = _wired(self.cell)
        driver = _driver(self.part, cell, hand)
        names = _joint_names(self.part, cell, hand)
        with driver:
            end = time.monotonic() + self.seconds
            while True:
                state = driver.read()
                joints = "  ".join(f"{n} {q:.3f}" for n, q in zip(names, state.positions, strict=True))
                print(f"{state.status}  {joints} rad", flush=True)
                if time.monotonic() + 0.5 > end:
                    return
                time.sleep(0.5)


@dataclass(frozen=True)
class Hold:
    """Switch an arm or a hand on where it is, and hold; a device that moves now is not ready."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    part: Part
    """Which device."""
    seconds: float = 5.0
    """For so long [s]."""

    def run(self) -> None:
        import numpy as np

        from fungrasp.robots.jog import PERIOD, follow

        cell, hand = _wired(self.cell)
        with _switch(cell) as switch:
            _ask(switch, f"hold the {self.part} where it is for {self.seconds:g} s")
            with _guarded(self.part, cell, hand, switch) as driver:
                rest = driver.read().positions
                count = max(1, int(self.seconds / PERIOD))
                state = follow(driver, np.tile(rest, (count, 1)))
                moved = float(np.abs(state.positions - rest).max())
        print(f"held within {moved:.3f} rad")


@dataclass(frozen=True)
class Jog:
    """Move one joint of an arm or a hand slowly by a small angle, and back; the others hold."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    part: Part
    """Which device."""
    joint: Annotated[str, tyro.conf.Positional]
    """Name of the joint, as `robots read` shows it."""
    by: float = 0.1
    """Angle [rad], 0.2 at most."""

    def run(self) -> None:
        from fungrasp.errors import UnknownNameError
        from fungrasp.robots.jog import jog

        cell, hand = _wired(self.cell)
        names = _joint_names(self.part, cell, hand)
        if self.joint not in names:
            raise UnknownNameError("joint", self.joint, names)
        with _switch(cell) as switch:
            _ask(switch, f"move '{self.joint}' of the {self.part} by {self.by:g} rad and back")
            with _guarded(self.part, cell, hand, switch) as driver:
                number = names.index(self.joint)
                rest = driver.read().positions[number]
                far, back = jog(driver, number, self.by)
        there, here = (float(state.positions[number] - rest) for state in (far, back))
        print(f"{self.joint}: moved by {there:.3f} rad, and back to {here:.3f} rad from where it was")


def _wired(name: str) -> tuple[RobotCell, Hand]:
    """A cell of real or emulated devices, and its hand."""
    from fungrasp.errors import FungraspError
    from fungrasp.hands import load_hand
    from fungrasp.robots.assembly import is_twin
    from fungrasp.robots.cell import load_cell

    cell = load_cell(name if Path(name).suffix != ".toml" else Path(name))
    if is_twin(cell):
        raise FungraspError(f"cell '{cell.name}' is a twin: it has no devices to connect to")
    return cell, load_hand(cell.hand)


def _joint_names(part: str, cell: RobotCell, hand: Hand) -> list[str]:
    from fungrasp.hands.arm import arm_spec

    if part == "hand":
        return list(hand.actuators)
    return [actuator.name for actuator in arm_spec(cell.arm.model).actuators]


def _switch(cell: RobotCell) -> StopSwitch:
    from fungrasp.robots.stop_switch import StopSwitch

    return StopSwitch(cell.stop_file, keyboard=True)


def _driver(part: str, cell: RobotCell, hand: Hand) -> JointDriver:
    """To look at."""
    from fungrasp.robots.assembly import arm_driver, hand_driver

    return arm_driver(cell) if part == "arm" else hand_driver(cell, hand)


def _guarded(part: str, cell: RobotCell, hand: Hand, switch: StopSwitch) -> GuardedDriver:
    """To move."""
    from fungrasp.robots.assembly import guarded_arm, guarded_hand

    return (guarded_arm if part == "arm" else guarded_hand)(cell, hand, switch)


def _ask(switch: StopSwitch, what: str) -> None:
    """Nothing moves before a person says yes."""
    from fungrasp.errors import FungraspError

    question = f"This will {what}. Nobody within reach, a hand on the emergency stop? Type 'yes': "
    try:
        answer = switch.ask(question)
    except EOFError:
        raise FungraspError("this moves a robot and asks first: it needs a terminal") from None
    if answer.lower() != "yes":
        raise FungraspError("not confirmed: nothing has moved")
    print(f"to stop: {switch.ways}", flush=True)
